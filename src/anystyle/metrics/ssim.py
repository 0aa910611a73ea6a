"""SSIM: how much of the photographs' structure is in stylized images."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.metrics.base import Pairs, RowMean, mean_per_row
from anystyle.types import Comparison

WINDOW, SIGMA = 11, 1.5
"""Side and deviation in pixels of the published window, a Gaussian."""
C1, C2 = 0.01**2, 0.03**2
"""The published constants for images in [0, 1]."""


class SSIM(RowMean):
    """Structural similarity of reconstructions (Wang et al. 2004) with the published Gaussian window, in [-1, 1].

    ``(2 m n + C1) (2 cov + C2) / ((m^2 + n^2 + C1) (var + var' + C2))``, each channel by itself, averaged over the
    pixels whose window lies inside of the image.

    Example:
        >>> metric = SSIM()
        >>> metric.update(torch.full((1, 3, 16, 16), 0.1), torch.zeros(1, 3, 16, 16))
        >>> metric.compute()  # the luminance term, 0.01^2 / (0.1^2 + 0.01^2)
        tensor(0.0099)
    """

    better: ClassVar[Mapping[str, str]] = {"ssim": "higher"}
    takes = ("preds", "target")

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        height, width = comparison.stylized.shape[-2:]
        if min(height, width) < WINDOW:
            raise UserError(f"ssim got images of {height}x{width} pixels; its window needs {WINDOW}: enlarge them")
        return mean_per_row(comparison, _similarities)


def _similarities(batch: Pairs) -> Float[Tensor, " M"]:
    # One channel at a time fits a CPU's cache.
    planes = zip(batch.preds.flatten(0, 1), batch.target.flatten(0, 1), strict=True)
    return torch.stack([_similarity(*plane) for plane in planes]).unflatten(0, (-1, 3)).mean(1)


def _similarity(x: Float[Tensor, "H W"], y: Float[Tensor, "H W"]) -> Float[Tensor, ""]:
    x, y = x.double(), y.double()  # variances are small differences of means
    mean_x, mean_y, squares, product = map(_windowed, (x, y, x * x + y * y, x * y))
    means, squared_means = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
    luminance = (2 * means + C1) / (squared_means + C1)
    variances = (squares - squared_means).clamp_min(0)
    return (luminance * (2 * (product - means) + C2) / (variances + C2)).mean()


def _windowed(image: Float[Tensor, "H W"]) -> Float[Tensor, "h w"]:
    """Means over the window where it lies inside of the image: a sum of shifted copies along each axis."""
    distance = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weights = torch.softmax(-(distance**2) / (2 * SIGMA**2), 0).tolist()
    for axis in (-2, -1):
        size = image.shape[axis] - WINDOW + 1
        total = torch.zeros_like(image.narrow(axis, 0, size))
        for shift, weight in enumerate(weights):
            total.add_(image.narrow(axis, shift, size), alpha=weight)
        image = total
    return image
