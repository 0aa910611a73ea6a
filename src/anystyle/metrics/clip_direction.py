"""CLIP direction: whether stylization changes images, in the encoder's space, towards the style."""

from collections.abc import Mapping
from typing import ClassVar

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder, neutral_embedding
from anystyle.metrics._embeddings import embed, embed_styles, of_given_rows
from anystyle.metrics._mean import RowMean
from anystyle.types import Comparison


class ClipDirection(RowMean):
    """Cosine of ``E(stylized) - E(photograph)`` and ``E(style) - E(neutral)`` (StyleGAN-NADA, Gal et al. 2022).

    Averaged over views, in [-1, 1]. A style's text counts if it has one, else its image.

    Args:
        size: Side that images are squashed to before, bicubic; none leaves that to the encoder.
    """

    better: ClassVar[Mapping[str, str]] = {"clip_direction": "higher"}

    def __init__(self, *, style_encoder: StyleEncoder, size: int | None = 224) -> None:
        super().__init__()
        # Held, not owned: whoever configured the encoder keeps its weights.
        self._encoder = (style_encoder,)
        self.size = size

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views.

        Raises:
            ValueError: There is no style.
        """
        encoder = self._encoder[0]
        styles, given = embed_styles(encoder, comparison, self.size)
        directions = F.normalize(styles - neutral_embedding(encoder).to(styles), dim=-1)

        def cosine(row: int) -> Tensor:
            target = embed(encoder, comparison.content[row], self.size)
            preds = embed(encoder, comparison.stylized[row], self.size)
            return (F.normalize(preds - target, dim=-1) @ directions[row]).mean()

        return of_given_rows(given, cosine)
