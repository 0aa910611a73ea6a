"""Colour histograms: how much of a stylized view has colours that the style image has as often."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import Pairs, RowMean, mean_per_row, with_style_images
from anystyle.types import Comparison

BINS = 8  # of each channel


class ColorHistogram(RowMean):
    """One less the intersection of the RGB histograms of a stylized view and its style image, in [0, 1].

    The intersection ``sum_j min(h_j, s_j)`` (Swain and Ballard, Color Indexing, IJCV 1991, section 3.1) of joint
    histograms of 8 x 8 x 8 equal bins over sRGB values, each summing to 1: the distance is half the sum of the
    absolute differences, the share of pixels that would have to change their bin. ``color_match`` compares chroma
    alone. Rows without a style image are left out.

    Example:
        >>> black, gray = torch.zeros(1, 3, 8, 8), torch.zeros(1, 3, 8, 8)
        >>> gray[..., :6] = 0.5
        >>> metric = ColorHistogram()
        >>> metric.update(black, style=gray)
        >>> metric.compute()
        {'color_histogram': tensor(0.7500)}
    """

    better: ClassVar[Mapping[str, str]] = {"color_histogram": "lower"}
    takes = ("preds", "style")

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        comparison, style = with_style_images(comparison)
        target = rgb_histogram(style)

        def distances(batch: Pairs) -> Tensor:
            return 1 - torch.minimum(rgb_histogram(batch.preds), target[batch.rows]).sum(1)

        return mean_per_row(comparison, distances)


def rgb_histogram(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 512"]:
    """The share of an image's pixels in each bin, red first; bins are half-open but for the last."""
    red, green, blue = (images * BINS).clamp_(0, BINS - 1).int().flatten(2).unbind(1)
    image = torch.arange(len(images), device=images.device, dtype=torch.int32)[:, None]
    index = ((image * BINS + red) * BINS + green) * BINS + blue
    counts = torch.bincount(index.flatten(), minlength=len(images) * BINS**3)
    return counts.view(len(images), -1).double() / index.shape[1]
