"""Colour match: how far the colours of stylized images are from those of the style image."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._mean import RowMean
from anystyle.metrics._pairs import pairs, row_means, style_images
from anystyle.perception import pictures
from anystyle.perception.histogram import hellinger, rgb_uv_histogram
from anystyle.perception.memo import MEMO, fingerprints
from anystyle.types import Comparison

TOGETHER = 2
"""Images whose kernels, 65536 pixels times 64 bins each, are held at once."""


class ColorMatch(RowMean):
    """Hellinger distance of RGB-uv histograms (HistoGAN, Afifi et al. 2021; eval_histogan.py), in [0, 1].

    Rows without a style image are left out.

    Args:
        variant: ``reference`` has images of 8 bits, as files; ``corrected`` rounds nothing.
    """

    better: ClassVar[Mapping[str, str]] = {"color_match": "lower"}
    higher_is_better = False

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference") -> None:
        super().__init__()
        self.rounded = variant == "reference"

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views.

        Raises:
            ValueError: No row has a style image.
        """
        image, given = style_images(comparison)
        wanted = self._histograms(image, fingerprints(image))
        rows: dict[int, list[Tensor]] = {}
        for some in pairs(comparison):
            if bool(given[some.row]):
                found = self._histograms(some.stylized, some.stylized_marks)
                rows.setdefault(some.row, []).append(hellinger(found, wanted[some.row].expand_as(found)))
        return row_means(rows)

    def _histograms(self, images: Tensor, marks: list[str]) -> Tensor:
        def count(some: Tensor) -> list[Tensor]:
            some = pictures.eight_bit(some) if self.rounded else some
            return [torch.cat([rgb_uv_histogram(part) for part in some.split(TOGETHER)])]

        return MEMO.rows(images, marks, ("rgb-uv", self.rounded), count)[0]
