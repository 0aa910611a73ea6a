"""The base of renderers: options and checks that they share, and compositing over the background."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import LinearView, Renderer
from anystyle.errors import UserError
from anystyle.geometry.harmonics import degree_of
from anystyle.ranges import NonNegative, Positive, Share
from anystyle.types import Cameras, Gaussians, Renders


@dataclass(kw_only=True, eq=False)
class RendererOptions:
    """Options of every renderer.

    Args:
        background: Colour in [0, 1] behind the scene.
        near: Distance along z, above 0, under which centres are culled; the default is the published renderer's.
        far: Distance along z over which centres are culled.
        eps2d: Low-pass filter of a pixel: variance in pixels² added to every Gaussian in the image.
    """

    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    near: Positive = 1e-10
    far: Positive = 1e10
    eps2d: NonNegative = 0.3


class Rasterizer(RendererOptions, Renderer):
    """Accumulates Gaussians over black, and composites the result over a background."""

    def __call__(self, gaussians: Gaussians, cameras: Cameras) -> Renders:
        """Render every camera of every scene."""
        check(gaussians, cameras)
        device = gaussians.means.device
        if self.devices and device.type not in self.devices:
            raise UserError(
                f"{type(self).__name__} runs on {' and '.join(self.devices)}, and the tensors are on {device}; use "
                f"renderer=auto, or move Gaussians and cameras with .to({self.devices[0]!r})"
            )
        return composite(self.accumulate(gaussians, cameras), self.background)

    @abstractmethod
    def accumulate(self, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "B V 5 H W"]:
        """Red, green, blue and depth over black, not clamped, and the transmittance."""


@dataclass(kw_only=True, eq=False)
class CappedRasterizer(Rasterizer):
    """A rasteriser with a configurable cap on alpha.

    Args:
        alpha_cap: The largest alpha of one Gaussian in a pixel: 0.999 in gsplat to 1.5.3, which the published models
            used, 0.99 in gsplat 1.6.
    """

    alpha_cap: Share = 0.999


def check(gaussians: Gaussians, cameras: Cameras) -> None:
    """Check that Gaussians and cameras belong together."""
    scenes, given = gaussians.means.shape[0], cameras.world_from_camera.shape[0]
    if scenes != given:
        raise UserError(
            f"Gaussians of {scenes} scenes and cameras of {given} scenes; "
            "give the cameras of each scene, or expand one of the two"
        )
    if gaussians.means.device != cameras.world_from_camera.device:
        raise UserError(
            f"Gaussians on {gaussians.means.device} and cameras on {cameras.world_from_camera.device}; "
            "move one of the two with .to(device)"
        )
    if min(cameras.size) < 1:
        raise UserError(f"an image of {cameras.size[0]}x{cameras.size[1]} pixels; expected at least 1x1")
    degree_of(gaussians.harmonics.shape[-2])


def at_least_single(gaussians: Gaussians, cameras: Cameras) -> tuple[Gaussians, Cameras]:
    """Both in the Gaussians' precision, or in single where that is half, whose rounding would shift them by pixels."""
    dtype = torch.promote_types(gaussians.means.dtype, torch.float32)
    return gaussians.to(dtype), cameras.to(dtype)


def composite(image: Float[Tensor, "B V 5 H W"], background: Sequence[float]) -> Renders:
    """Composite accumulated images over a background, and clamp colours to [0, 1].

    Args:
        image: Red, green, blue and depth over black, and the transmittance.
        background: A colour in [0, 1].
    """
    color, depth, transmittance = image.split([3, 1, 1], dim=2)
    behind, alpha = image.new_tensor(list(background))[:, None, None], 1 - transmittance[:, :, 0]
    return Renders(color=(color + transmittance * behind).clamp(0, 1), depth=depth[:, :, 0], alpha=alpha)


class KeptView(LinearView):
    """The Gaussians of one view, projected and listed by tile once, which are blended again for other colours.

    Args:
        image: What the view shows: red, green, blue and depth over black, and the transmittance.
        background: A colour in [0, 1].
        blend: Colours of all Gaussians over black, differentiable once.
        number: Of these Gaussians.
        kept: What ``blend`` holds in memory.
    """

    def __init__(
        self,
        image: Float[Tensor, "5 H W"],
        background: Sequence[float],
        blend: Callable[[Float[Tensor, "N 3"]], Float[Tensor, "3 H W"]],
        number: int,
        kept: Sequence[Tensor],
    ) -> None:
        self.render = composite(image[None, None], background)
        self.background = image[4] * image.new_tensor(list(background))[:, None, None]
        self._blend, self._none = blend, image.new_zeros(number, 3).requires_grad_()
        with torch.enable_grad():
            self._black = blend(self._none)
        self.nbytes = sum(tensor.nbytes for tensor in (*kept, self._none, self._black, image))

    def __call__(self, colors: Float[Tensor, "N 3"]) -> Float[Tensor, "3 H W"]:
        return self._blend(colors.detach().float())

    def transposed(self, pixels: Float[Tensor, "3 H W"]) -> Float[Tensor, "N 3"]:
        return torch.autograd.grad(self._black, self._none, pixels.detach().float(), retain_graph=True)[0]
