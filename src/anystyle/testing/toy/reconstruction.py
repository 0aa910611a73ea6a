"""A wall: the smallest reconstruction that needs cameras."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Reconstruction, Renderer
from anystyle.types import Gaussians, Geometry, OnProgress, Reconstructed, Scene, Views, no_progress


class ToyReconstruction(Reconstruction):
    """A Gaussian at every few pixels of each view, all at one depth.

    Args:
        depth: Along the camera's z axis.
        stride: Pixels between two Gaussians.
    """

    needs_cameras = True

    def __init__(self, *, depth: float = 4.0, stride: int = 4) -> None:
        self.depth, self.stride = depth, stride

    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        on_progress: OnProgress = no_progress,
    ) -> Reconstructed:
        if views.cameras is None:
            raise ValueError("a wall is put before cameras, and there are none; poses=sfm finds them")
        batch, number, _, height, width = views.images.shape
        depth = torch.full((batch, number, height, width), self.depth)
        geometry = Geometry(views.cameras, depth, torch.ones_like(depth))
        every = (torch.arange(number), torch.arange(0, height, self.stride), torch.arange(0, width, self.stride))
        view, row, column = torch.cartesian_prod(*every).unbind(1)
        count = len(view)
        gaussians = Gaussians(
            means=geometry.points()[:, view, row, column],
            rotations=torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(batch, count, 4).clone(),
            scales=torch.full((batch, count, 3), 0.02 * self.depth),
            opacities=torch.full((batch, count), 0.9),
            harmonics=views.images.movedim(2, -1)[:, view, row, column][:, :, None] - 0.5,
        )
        scene = replace(encode(views), geometry=geometry, gaussians=gaussians, clusters=None)
        return Reconstructed(scene, {"num_gaussians": float(count)})
