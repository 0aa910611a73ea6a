"""Sharpness: how much of the photographs' fine detail stylized views have."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import RowMean
from anystyle.types import Comparison


class Sharpness(RowMean):
    """Mean absolute difference of neighbouring pixels of the stylized views, divided by the photographs'.

    The mean is over both directions, all channels and views: the anisotropic total variation (Rudin, Osher and Fatemi
    1992) of a pixel. 1 is as sharp as the photographs, 0 is flat, and noise has many times their sharpness: it says how
    much a method blurs, and not how good its images are. Strokes differ in detail from style to style; divided by the
    figure of a method that paints each view alone, it says what a scene in 3D has lost of them. Rows whose photographs
    are flat are left out.

    Example:
        >>> photograph = torch.tensor([0.0, 0.4, 0.0, 0.4]).expand(1, 3, 4, 4)
        >>> metric = Sharpness()
        >>> metric.update(0.5 * photograph, photograph)
        >>> metric.compute()
        {'sharpness': tensor(0.5000)}
    """

    better: ClassVar[Mapping[str, str]] = {"sharpness": "higher"}
    takes = ("preds", "target")

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        ratio = total_variation(comparison.stylized) / (variation := total_variation(comparison.content))
        return torch.where(variation > 0, ratio, torch.nan)


def total_variation(images: Float[Tensor, "R V 3 H W"]) -> Float[Tensor, " R"]:
    """Mean absolute difference of pixels beside and below each other; 0 for images of one pixel."""
    steps = ((row.diff(dim=-1).abs_(), row.diff(dim=-2).abs_()) for row in images)
    return torch.stack([(x.sum().double() + y.sum()) / (x.numel() + y.numel()) for x, y in steps])
