"""Controls of a style: strength, colour preservation, size of strokes, and where it enters.

Each is a function of embeddings, images or colours that any model has; none depends on a backbone.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import product

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.errors import UserError
from anystyle.types import Cameras, Gaussians, SourceImage

LUMA = (0.2126, 0.7152, 0.0722)
"""Shares of red, green and blue in the brightness of sRGB (ITU-R BT.709)."""

MAX_SCALE = 8.0


@dataclass(frozen=True)
class SeenScene:
    """The views of a scene, for masks that are drawn on photographs.

    Args:
        sources: Where each view comes from.
        cameras: The cameras of the views, in the frame of the Gaussians.
        renderer: Differentiable in colours.
    """

    sources: Sequence[SourceImage]
    cameras: Cameras
    renderer: Renderer


class Mask(ABC):
    """How much of the style each Gaussian takes."""

    @property
    @abstractmethod
    def text(self) -> str:
        """The mask as an argument of the command line."""

    @abstractmethod
    def weights(self, gaussians: Gaussians, seen: SeenScene) -> Float[Tensor, "B N"]:
        """In [0, 1], 0 unstyled and 1 styled, for Gaussians of one scene and the views that it comes from."""


@dataclass(frozen=True)
class Controls:
    """How a style is applied.

    Args:
        strength: In [0, 1]; 0 is the unstyled scene, bit for bit.
        preserve_color: In [0, 1]: how much of the scene's own hues stays under the style's strokes.
        scale: Size of strokes. A model without strokes embeds the style image enlarged by it.
        mask: Where style enters; everywhere without one.
    """

    strength: float = 1.0
    preserve_color: float = 0.0
    scale: float = 1.0
    mask: Mask | None = None

    def __post_init__(self) -> None:
        for name in ("strength", "preserve_color"):
            if not 0 <= getattr(self, name) <= 1:
                raise UserError(f"{name} is {getattr(self, name)}; expected a number between 0 and 1")
        if not 1 / MAX_SCALE <= self.scale <= MAX_SCALE:
            raise UserError(f"scale is {self.scale}; expected a number between {1 / MAX_SCALE} and {MAX_SCALE:g}")

    @property
    def label(self) -> str:
        """What differs from the defaults, as text; empty where nothing does."""
        changed = [item.name for item in fields(self) if getattr(self, item.name) != item.default]
        numbers = [f"{name.replace('_', ' ')} {getattr(self, name):g}" for name in changed if name != "mask"]
        return ", ".join([*numbers, *(["mask"] if self.mask is not None else [])])


def _of_one_degree(*harmonics: Float[Tensor, "B N _ 3"]) -> list[Float[Tensor, "B N K 3"]]:
    most = max(tensor.shape[2] for tensor in harmonics)
    return [F.pad(tensor, (0, 0, 0, most - tensor.shape[2])) for tensor in harmonics]


def blended(unstyled: Gaussians, styled: Gaussians, weights: float | Float[Tensor, "B N"]) -> Gaussians:
    """The Gaussians at a share of the way from unstyled to styled: attributes straight, rotations on the sphere.

    Where a share is 0 or 1 the result has the bits of that end.
    """
    if unstyled.means.shape != styled.means.shape:
        raise UserError(f"{unstyled.means.shape[1]} and {styled.means.shape[1]} Gaussians are not of one scene")
    amount = torch.ones_like(styled.opacities) * torch.as_tensor(weights).to(styled.means)

    def between(name: str) -> Tensor:
        start, end = getattr(unstyled, name), getattr(styled, name)
        if name == "harmonics":
            start, end = _of_one_degree(start, end)
        part = amount.reshape(*amount.shape, *[1] * (start.ndim - 2))
        if name == "rotations":
            lengths = [tensor.norm(dim=-1, keepdim=True).clamp_min(1e-12) for tensor in (start, end)]
            sign = torch.where((start * end).sum(-1, keepdim=True) < 0, -1.0, 1.0)
            middle = F.normalize(torch.lerp(start / lengths[0], sign * end / lengths[1], part), dim=-1)
        else:
            middle = torch.lerp(start, end, part)
        return torch.where(part == 0, start, torch.where(part == 1, end, middle))

    return replace(styled, **{item.name: between(item.name) for item in fields(Gaussians)})


def with_colors_of(unstyled: Gaussians, styled: Gaussians, amount: float = 1.0) -> Gaussians:
    """Styled Gaussians in the hues of unstyled ones: their brightness alone changes.

    The luminance transfer of Gatys et al. 2016 (arXiv:1606.05897, section 4) for Gaussians: brightness is linear in
    the coefficients of harmonics, so it holds from every direction. An amount of 0 keeps the style's own
    colours.
    """
    content, style = _of_one_degree(unstyled.harmonics, styled.harmonics)
    brighter = (style - content) @ content.new_tensor(LUMA)  # B N K
    return replace(styled, harmonics=torch.lerp(style, content + brighter[..., None], amount))


def applied(
    controls: Controls, unstyled: Gaussians, styled: Gaussians, weights: float | Float[Tensor, "B N"] = 1.0
) -> Gaussians:
    """A styled scene under the controls of strength and of colours, weighted by a mask."""
    if controls.preserve_color > 0:
        styled = with_colors_of(unstyled, styled, controls.preserve_color)
    return blended(unstyled, styled, controls.strength * weights)


def rescaled(image: Float[Tensor, "3 H W"], scale: float) -> Float[Tensor, "3 H W"]:
    """An image of a style with strokes ``scale`` times as large: the middle enlarged, or all among its mirrors."""
    if scale == 1:
        return image
    height, width = image.shape[1:]
    y, x = (((torch.arange(side) + 0.5) / side * 2 - 1) / scale for side in (height, width))
    grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)[None].to(image)
    if scale > 1:
        return F.grid_sample(image[None], grid, "bicubic", "reflection", align_corners=False)[0].clamp(0, 1)
    size = (max(1, round(height * scale)), max(1, round(width * scale)))
    small = F.interpolate(image[None], size, mode="bilinear", antialias=True, align_corners=False)
    return F.grid_sample(small, grid, "bilinear", "reflection", align_corners=False)[0].clamp(0, 1)


def combinations(
    strength: Sequence[float] = (),
    preserve_color: Sequence[float] = (),
    scale: Sequence[float] = (),
    mask: Sequence[Mask] = (),
) -> list[Controls]:
    """Controls for every combination of the values given, defaults for what is not."""
    given = (mask or (None,), scale or (1.0,), preserve_color or (0.0,), strength or (1.0,))
    return [Controls(one, two, three, four) for four, three, two, one in product(*given)]
