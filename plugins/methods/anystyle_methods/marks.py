"""What the marks of a painting are like: how wide and how long they are, and how their colours vary."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import grid_sample, interpolate

from anystyle.geometry.warp import pixels
from anystyle_methods.flow import blur, flow, structure_tensor

REACH = 32
"""How far along a mark its lightness is compared, in pixels."""
CANDIDATES = 16  # random places, of which that with the nearest colour is taken
HALF = 0.5
"""The correlation of lightness at which a mark has ended."""


class Marks(NamedTuple):
    """The marks of a picture, of the strongest and clearest contours most."""

    width: float
    """In pixels, between the places to both sides where lightness correlates by less than a half."""
    length: float
    """The same along the flow; at most ``2 REACH``."""


def marks(pictures: Float[Tensor, "V 3 H W"], side: int) -> Marks:
    """Measure pictures whose shorter side is scaled to ``side`` pixels.

    Lightness without what is wider than ``side / 32`` pixels is correlated with itself, step by step along the flow of
    the structure tensor and across it.
    """
    scaled = scale_to(pictures, side)
    lightness = scaled.mean(1, keepdim=True)
    lightness = lightness - blur(lightness, side / 32)
    tensor = structure_tensor(scaled, 1.0, 4.0)
    direction, clarity = flow(tensor)
    weight = clarity * (tensor[:, 0] + tensor[:, 2]).sqrt()
    across = torch.stack([-direction[:, 1], direction[:, 0]], dim=1)
    return Marks(2 * _half(lightness, across, weight), 2 * _half(lightness, direction, weight))


class PaintingTexture:
    """How colours differ from those around them, at places of a picture.

    Args:
        pictures: With values in [0, 1].
        side: Pixels that their shorter side is scaled to.
        width: Pixels that "around" is, a standard deviation.
        strength: Factor of the differences.
    """

    def __init__(self, pictures: Float[Tensor, "V 3 H W"], side: int, width: float, strength: float) -> None:
        scaled = scale_to(pictures, side)
        self._around = blur(scaled, width)
        self._details = strength * (scaled - self._around)
        direction, _ = flow(structure_tensor(scaled, 1.0, width))
        self._across = torch.stack([-direction[:, 1], direction[:, 0]], dim=1)

    def sample(
        self, colors: Float[Tensor, "M 3"], offsets: Float[Tensor, " B"], generator: torch.Generator
    ) -> Float[Tensor, "B M 3"]:
        """Differences at random places with about these colours, and so many pixels beside them, across the flow."""
        count, _, height, width = self._around.shape
        size = torch.tensor([count, height, width])[:, None, None]
        view, y, x = (torch.rand(3, CANDIDATES, len(colors), generator=generator) * size).long().to(colors.device)
        nearest = (self._around[view, :, y, x] - colors).square().sum(2).argmin(0)
        view, y, x = (index.gather(0, nearest[None])[0] for index in (view, y, x))
        dx, dy = self._across[view, :, y, x].unbind(1)
        column = (x + offsets[:, None] * dx).round().long().clamp(0, width - 1)
        row = (y + offsets[:, None] * dy).round().long().clamp(0, height - 1)
        return self._details[view, :, row, column]


def scale_to(pictures: Float[Tensor, "V 3 H W"], side: int) -> Float[Tensor, "V 3 h w"]:
    """Pictures whose shorter side is this many pixels."""
    height, width = pictures.shape[-2:]
    scale = side / min(height, width)
    size = [max(side, round(height * scale)), max(side, round(width * scale))]
    return interpolate(pictures, size, mode="bilinear", antialias=True)


def _half(values: Float[Tensor, "V 1 H W"], field: Float[Tensor, "V 2 H W"], weight: Float[Tensor, "V H W"]) -> float:
    """How many steps along a field of unit vectors, which have no sign, until values correlate by half."""
    place = (pixels(values) + 0.5).expand_as(field)
    extent = values.new_tensor(values.shape[:1:-1])[:, None, None]

    def at(image: Tensor) -> Tensor:
        grid = (2 * place / extent - 1).movedim(1, -1)
        return grid_sample(image, grid, mode="nearest", padding_mode="reflection", align_corners=False)

    heading, own, before = field, values[:, 0], 1.0
    for step in range(1, REACH + 1):
        place = place + heading
        other = at(values)[:, 0]
        correlation = float(2 * (weight * own * other).sum() / (weight * (own.square() + other.square())).sum())
        if correlation < HALF:
            return step - (HALF - correlation) / (before - correlation)
        following, before = at(field), correlation
        heading = following * torch.where((following * heading).sum(1, keepdim=True) < 0, -1, 1)
    return float(REACH)
