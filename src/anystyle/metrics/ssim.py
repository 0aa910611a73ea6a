"""SSIM: how much of the photographs' structure is in stylized images."""

from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor
from torchmetrics.functional.image import structural_similarity_index_measure

from anystyle.errors import UserError
from anystyle.metrics.base import Pairs, RowMean, mean_per_row
from anystyle.types import Comparison

WINDOW = 11
"""Side in pixels of the published window, a Gaussian with a deviation of 1.5."""


class SSIM(RowMean):
    """Structural similarity of reconstructions (Wang et al. 2004) with the published Gaussian window, in [-1, 1].

    Each channel by itself, averaged over the pixels whose window lies inside of the image.
    """

    better: ClassVar[Mapping[str, str]] = {"ssim": "higher"}

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        height, width = comparison.stylized.shape[-2:]
        if min(height, width) < WINDOW:
            raise UserError(f"ssim got images of {height}x{width} pixels; its window needs {WINDOW}: enlarge them")
        return mean_per_row(comparison, _similarities)


def _similarities(batch: Pairs) -> Float[Tensor, " M"]:
    preds, target = batch.preds.double(), batch.target.double()
    _, maps = structural_similarity_index_measure(
        preds, target, sigma=1.5, data_range=1.0, reduction="none", return_full_image=True
    )
    border = WINDOW // 2
    return maps[..., border:-border, border:-border].mean((1, 2, 3))
