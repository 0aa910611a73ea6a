"""Depth as a scene's cameras see it, and which of it they agree on."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.types import Cameras, Gaussians, Geometry

OPAQUE = 0.9
"""Where less light is absorbed there is no surface."""
TOLERANCE = 0.03
"""Depths of one point from two cameras that differ by a smaller part of them agree."""
NEIGHBORS, WITNESSES = 8, 2
"""Other cameras that are asked for each pixel, and how many of them have to agree; one where there are two cameras."""


@dataclass(frozen=True)
class DepthViews:
    """Rendered views of one scene.

    Args:
        cameras: A batch of one scene.
        color: In [0, 1].
        depth: Along the optical axis; 0 where there is no surface.
        agreed: Where other cameras see the same point at the same depth.
    """

    cameras: Cameras
    color: Float[Tensor, "V 3 H W"]
    depth: Float[Tensor, "V H W"]
    agreed: Bool[Tensor, "V H W"]

    @property
    def agreement(self) -> float:
        """The part of all surfaces that is agreed on, in [0, 1]."""
        return int(self.agreed.sum()) / max(1, int((self.depth > 0).sum()))

    @property
    def points(self) -> Float[Tensor, "V H W 3"]:
        """The points in world space that the pixels show."""
        return Geometry(self.cameras, self.depth[None], self.depth[None]).points()[0]

    def seen_at(
        self, view: int, points: Float[Tensor, "N 3"]
    ) -> tuple[Float[Tensor, "N 2"], Float[Tensor, " N"], Float[Tensor, " N"]]:
        """Where a view shows points, as :func:`sampled` counts, their depth, and the depth that the view sees there."""
        pose, matrix = self.cameras.world_from_camera[0, view], self.cameras.intrinsics[0, view]
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        pixels = local @ matrix.T / local[:, 2:].clamp_min(1e-6)
        height, width = self.cameras.size
        where = torch.where(local[:, 2:] > 0, 2 * pixels[:, :2] / pixels.new_tensor([width, height]) - 1, 2.0)
        return where, local[:, 2], sampled(self.depth[view][None], where)[0]


@torch.no_grad()
def render_depth(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> DepthViews:
    """Render all views of a batch of one scene, and compare their depths."""
    colors, depths = [], []
    for view in range(cameras.intrinsics.shape[1]):
        renders = renderer(gaussians, cameras.select([view]))
        alpha = renders.alpha[0, 0].cpu()
        depths.append(torch.where(alpha > OPAQUE, renders.depth[0, 0].cpu() / alpha.clamp_min(OPAQUE), 0))
        colors.append(renders.color[0, 0].cpu())
    depth = torch.stack(depths)
    views = DepthViews(cameras.to("cpu"), torch.stack(colors), depth, depth > 0)
    points, count = views.points.flatten(1, 2), len(depth)
    centers = views.cameras.world_from_camera[0, :, :3, 3]
    nearest = torch.cdist(centers, centers).argsort(dim=1, stable=True)
    for view in range(count):
        votes = torch.zeros(depth[view].numel(), dtype=torch.int)
        for other in [index for index in nearest[view].tolist() if index != view][:NEIGHBORS]:
            _, z, found = views.seen_at(other, points[view])
            votes += (found > 0) & ((found - z).abs() < TOLERANCE * z)
        views.agreed[view] &= votes.view(depth[view].shape) >= min(WITNESSES, count - 1)
    return views


def sampled(image: Float[Tensor, "C H W"], where: Float[Tensor, "N 2"], mode: str = "nearest") -> Float[Tensor, "C N"]:
    """Values of an image at places, from -1 to 1 as ``grid_sample`` counts; 0 outside."""
    return F.grid_sample(image[None], where[None, None], mode=mode, align_corners=False)[0, :, 0]
