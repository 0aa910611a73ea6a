"""Stripes: styles whose texts say exactly what is in the image."""

from itertools import combinations
from typing import Annotated

import torch

from anystyle.contracts import StyleSource
from anystyle.ranges import AtLeastOne, Range
from anystyle.types import Style

COLORS = {"red": (0.8, 0.1, 0.1), "green": (0.1, 0.6, 0.2), "blue": (0.1, 0.2, 0.8), "white": (0.95, 0.95, 0.95)}


class ToyStyles(StyleSource):
    """Stripes of two colours, in every pair and two directions.

    Args:
        size: Side of the image in pixels.
        period: Pixels from stripe to stripe.
    """

    def __init__(self, *, size: AtLeastOne = 64, period: Annotated[int, Range(ge=2)] = 16) -> None:
        self.size, self.period = size, period
        self.pairs = list(combinations(sorted(COLORS), 2))

    def __len__(self) -> int:
        return 2 * len(self.pairs)

    def read(self, style: int) -> Style:
        one, other = self.pairs[style // 2]
        first = torch.arange(self.size) % self.period < self.period // 2
        stripes = torch.where(first[:, None], torch.tensor(COLORS[one]), torch.tensor(COLORS[other]))  # size 3
        image = stripes.T[None, :, :, None].expand(1, 3, self.size, self.size)
        direction, image = ("vertical", image.mT) if style % 2 else ("horizontal", image)
        text, name = f"{direction} stripes in {one} and {other}", f"{one}_{other}_{direction}"
        return Style(image.contiguous(), (text,), names=(name,))
