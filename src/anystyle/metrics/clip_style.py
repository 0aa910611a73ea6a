"""CLIP style: how close stylized images are, in the encoder's space, to the style."""

from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._embeddings import StyleCosine
from anystyle.types import Comparison


class ClipStyle(StyleCosine):
    """Cosine of ``E(stylized)`` and ``E(style)``, averaged over views, in [-1, 1].

    A style's text counts if it has one, else its image.
    """

    better: ClassVar[Mapping[str, str]] = {"clip_style": "higher"}

    def of_views(self, comparison: Comparison, row: int) -> Float[Tensor, "V D"]:
        return self.embed(comparison.stylized[row])

    def of_styles(self, styles: Float[Tensor, "B D"]) -> Float[Tensor, "B D"]:
        return styles
