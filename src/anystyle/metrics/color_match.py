"""Colour match: how far the colours of stylized images are from those of the style image."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import RowMean, mean_per_row, with_style_images
from anystyle.types import Comparison
from anystyle.vision import preprocess
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.statistics import hellinger, rgb_uv_histogram


class ColorMatch(RowMean):
    """Hellinger distance of RGB-uv histograms (HistoGAN, Afifi et al. 2021; eval_histogan.py), in [0, 1].

    ``sqrt(sum (sqrt h - sqrt s)^2) / sqrt 2``. Rows without a style image are left out.

    Args:
        variant: ``reference`` has images of 8 bits, as files; ``corrected`` rounds nothing.

    Example:
        >>> images = torch.rand(1, 3, 16, 16)
        >>> metric = ColorMatch()
        >>> metric.update(images, images.flip(-1))  # the same colours elsewhere
        >>> print(f"{metric.compute():.3f}")
        0.000
    """

    better: ClassVar[Mapping[str, str]] = {"color_match": "lower"}
    takes = ("preds", "style")

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference") -> None:
        super().__init__()
        self.rounded = variant == "reference"

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        comparison, style = with_style_images(comparison)
        target = self._histograms(style)
        return mean_per_row(comparison, lambda batch: hellinger(self._histograms(batch.preds), target[batch.rows]))

    def _histograms(self, images: Tensor) -> Tensor:
        def histograms(batch: Tensor) -> list[Tensor]:
            return [rgb_uv_histogram(preprocess.eight_bit(batch) if self.rounded else batch)]

        return CACHE.features(images, ("rgb-uv", self.rounded), histograms)[0]
