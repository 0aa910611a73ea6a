"""What every renderer begins and ends with."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.geometry.harmonics import degree_of
from anystyle.types import Cameras, Gaussians, Renders

FASTEST = {"cuda": "gsplat", "cpu": "cpu"}
"""The renderer for a type of device; ``torch`` runs on all others."""


class Rasterizer(Renderer):
    """Accumulates Gaussians over black, and lays the result over a background.

    Args:
        background: Colour in [0, 1] behind the scene.
        near: Distance along z, above 0, under which centres are not seen; the published renderer's default.
        far: Distance along z over which centres are not seen.
        eps2d: Low-pass filter of a pixel: variance in pixels² added to every Gaussian in the image.
    """

    device: ClassVar[str | None] = None
    """The only type of device that it runs on; ``None`` for any."""

    def __init__(
        self,
        *,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        near: float = 1e-10,
        far: float = 1e10,
        eps2d: float = 0.3,
    ) -> None:
        self.background = background
        self.near = near
        self.far = far
        self.eps2d = eps2d

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """Render every camera of every scene.

        Raises:
            ValueError: The tensors are on a device that the renderer is not for, or do not belong together.
            ImportError: What the renderer needs is not installed.
        """
        check(gaussians, cameras, self.background, self.near)
        device = gaussians.means.device
        if self.device not in (None, device.type):
            raise ValueError(
                f"the renderer {FASTEST[self.device]!r} was given tensors on {device}; use "
                f"renderer={FASTEST.get(device.type, 'torch')} there, or move the Gaussians and cameras with "
                f".to({self.device!r})"
            )
        return over(self.accumulate(gaussians, cameras), self.background)

    @abstractmethod
    def accumulate(self, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "B V 5 H W"]:
        """Red, green, blue and depth over black and before any cut, and the share of light that passes."""


class CappedRasterizer(Rasterizer):
    """One whose Gaussians each cover a pixel up to a cap.

    Args:
        alpha_cap: The most one Gaussian covers of a pixel: 0.999 in gsplat to 1.5.3, which the published models used,
            0.99 in gsplat 1.6.
    """

    def __init__(
        self,
        *,
        background: tuple[float, float, float] = (1.0, 1.0, 1.0),
        near: float = 1e-10,
        far: float = 1e10,
        eps2d: float = 0.3,
        alpha_cap: float = 0.999,
    ) -> None:
        super().__init__(background=background, near=near, far=far, eps2d=eps2d)
        self.alpha_cap = alpha_cap


def check(gaussians: Gaussians, cameras: Cameras, background: Sequence[float], near: float) -> None:
    """Refuse what cannot be rendered.

    Raises:
        ValueError: Gaussians and cameras are of different batches or devices, or a size or colour makes no sense.
    """
    if gaussians.means.shape[0] != cameras.world_from_camera.shape[0]:
        raise ValueError(
            f"Gaussians of {gaussians.means.shape[0]} scenes and cameras of {cameras.world_from_camera.shape[0]}; "
            "give the cameras of each scene, or expand one of the two"
        )
    if gaussians.means.device != cameras.world_from_camera.device:
        raise ValueError(
            f"Gaussians on {gaussians.means.device} and cameras on {cameras.world_from_camera.device}; "
            "move one of the two with .to(device)"
        )
    if min(cameras.size) < 1:
        raise ValueError(f"an image of {cameras.size[0]}x{cameras.size[1]} pixels; expected at least 1x1")
    if len(background) != 3:
        raise ValueError(f"a background of {len(background)} values; expected 3, one a channel in [0, 1]")
    if not near > 0:
        raise ValueError(f"near is {near}; expected a distance above 0, such as 0.01")
    degree_of(gaussians.harmonics.shape[-2])


def at_least_single(gaussians: Gaussians, cameras: Cameras) -> tuple[Gaussians, Cameras]:
    """Both in one precision: the Gaussians', or single where theirs is half, which would move them by pixels."""
    dtype = torch.promote_types(gaussians.means.dtype, torch.float32)
    return gaussians.to(dtype), cameras.to(dtype)


def over(image: Float[Tensor, "B V 5 H W"], background: Sequence[float]) -> Renders:
    """Lay what was accumulated over a background, and cut colours to [0, 1].

    Args:
        image: Red, green, blue and depth over black, and the share of light that passes.
        background: A colour in [0, 1].
    """
    color, depth, passing = image[:, :, :3], image[:, :, 3], image[:, :, 4:]
    behind = image.new_tensor(list(background))[:, None, None]  # 3 1 1
    return Renders(color=(color + passing * behind).clamp(0, 1), depth=depth, alpha=1 - passing[:, :, 0])
