"""SSIM: how much of the photographs' structure is in stylized images."""

from collections.abc import Mapping
from typing import ClassVar

import kornia
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._pairs import Pairs, RowMean, mean_per_row
from anystyle.types import Comparison

WINDOW = 11
"""Side in pixels of the published window, a Gaussian with a deviation of 1.5."""


class SSIM(RowMean):
    """Structural similarity of reconstructions (Wang et al. 2004) with the published Gaussian window, in [-1, 1].

    Each channel by itself, averaged over the pixels whose window lies inside of the image.
    """

    better: ClassVar[Mapping[str, str]] = {"ssim": "higher"}

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views.

        Raises:
            ValueError: The images are smaller than the window.
        """
        height, width = comparison.stylized.shape[-2:]
        if min(height, width) < WINDOW:
            raise ValueError(f"ssim got images of {height}x{width} pixels; its window needs {WINDOW}: enlarge them")
        return mean_per_row(comparison, _similarities)


def _similarities(batch: Pairs) -> Float[Tensor, " M"]:
    maps = kornia.metrics.ssim(batch.preds.double(), batch.target.double(), WINDOW, eps=0.0, padding="valid")
    return maps.mean((1, 2, 3))
