"""PSNR: how far stylized images are from the photographs, in decibels."""

from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import Pairs, RowMean, mean_per_row
from anystyle.ranges import Positive
from anystyle.types import Comparison


class PSNR(RowMean):
    """Peak signal-to-noise ratio of reconstructions: the mean over images of ``-10 log10 MSE``.

    Args:
        most: Where the ratio of an image is cut off, in decibels: equal images would be infinitely good.

    Example:
        >>> metric = PSNR()
        >>> metric.update(torch.full((2, 3, 8, 8), 0.1), torch.zeros(2, 3, 8, 8))
        >>> print(f"{metric.compute():.3f}")
        20.000
    """

    better: ClassVar[Mapping[str, str]] = {"psnr": "higher"}
    takes = ("preds", "target")

    def __init__(self, *, most: Positive = 100.0) -> None:
        super().__init__()
        self.most = most

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        return mean_per_row(comparison, self._decibels)

    def _decibels(self, batch: Pairs) -> Float[Tensor, " M"]:
        return (-10 * (batch.preds - batch.target).square_().mean((1, 2, 3)).double().log10()).clamp_max(self.most)
