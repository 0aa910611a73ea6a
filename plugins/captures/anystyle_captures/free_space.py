"""The space that photographs see through."""

from dataclasses import dataclass
from math import inf, nan

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import max_pool2d

from anystyle.types import Cameras, Value
from anystyle_captures.initial import farthest
from anystyle_captures.pixels import pixels_of
from anystyle_captures.stereo import StereoDepth

NEARER = 0.85
"""A point nearer than this fraction of a surface lies before it, and on it as far to both sides."""
BEFORE_SKY = 0.5
"""The space before the sky reaches up to this fraction of the backdrop's depth."""
AROUND = 5
"""Side in pixels of the window whose nearest surface counts."""
MIN_VIEWS, MIN_SHARE = 2, 1 / 3
"""Views that must see past a point, for one depth may be wrong, and which share of those whose image it lies in."""


@dataclass(frozen=True)
class FreeSpace(Value):
    """The space between cameras and the surfaces on which two views agree.

    Args:
        surfaces: Depths, not a number where no second view supports one.
        cameras: Those of the images that the depths were found in.
    """

    surfaces: Float[Tensor, "V H W"]
    cameras: Cameras

    @classmethod
    def of(cls, stereo: StereoDepth, cameras: Cameras) -> "FreeSpace":
        """What the depths by stereo say."""
        known = torch.where(stereo.support >= 1, stereo.depth, inf)
        if bool(stereo.depth.isposinf().any()):
            known[stereo.depth.isposinf()] = BEFORE_SKY * farthest(stereo)
        # The nearest around a pixel: beside an outline, cameras that are not exact see past what is there.
        return cls(torch.where(known.isfinite(), -max_pool2d(-known, AROUND, 1, AROUND // 2), nan), cameras)

    @torch.no_grad()
    def contains(self, points: Float[Tensor, "N 3"]) -> Bool[Tensor, " N"]:
        """Which points lie before the surfaces of enough views, and of more than have a surface there."""
        before, on, inside = (torch.zeros_like(points[:, 0], dtype=torch.long) for _ in range(3))
        for view, surface in enumerate(self.surfaces):
            pixels = pixels_of(points, self.cameras, view)
            relative = pixels.depth / surface[pixels.row, pixels.column]
            before += pixels.within & (relative < NEARER)
            inside += pixels.within
            on += pixels.within & ((relative - 1).abs() < 1 - NEARER)
        return (before >= MIN_VIEWS) & (before > on) & (before > MIN_SHARE * inside)
