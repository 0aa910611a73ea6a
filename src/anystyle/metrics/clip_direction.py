"""CLIP direction: whether stylization changes images, in the encoder's space, towards the style."""

from collections.abc import Mapping
from typing import ClassVar

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import neutral_embedding
from anystyle.metrics._embeddings import StyleCosine
from anystyle.types import Comparison


class ClipDirection(StyleCosine):
    """Cosine of ``E(stylized) - E(photograph)`` and ``E(style) - E(neutral)`` (StyleGAN-NADA, Gal et al. 2022).

    Averaged over views, in [-1, 1]. A style's text counts if it has one, else its image.
    """

    better: ClassVar[Mapping[str, str]] = {"clip_direction": "higher"}

    def of_views(self, comparison: Comparison, row: int) -> Float[Tensor, "V D"]:
        return self.embed(comparison.stylized[row]) - self.embed(comparison.content[row])

    def of_styles(self, styles: Float[Tensor, "B D"]) -> Float[Tensor, "B D"]:
        return styles - neutral_embedding(self.encoder).to(styles)
