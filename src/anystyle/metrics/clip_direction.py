"""CLIP direction: whether stylization changes images, in the encoder's space, towards the style."""

from collections.abc import Mapping
from typing import ClassVar

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder, neutral_embedding
from anystyle.metrics._embeddings import embed, row_by_row, wanted
from anystyle.metrics._mean import RowMean
from anystyle.perception.memo import fingerprints
from anystyle.types import Comparison


class ClipDirection(RowMean):
    """Cosine of ``E(stylized) - E(photograph)`` and ``E(style) - E(neutral)`` (StyleGAN-NADA, Gal et al. 2022).

    Averaged over views, in [-1, 1]. A style's text counts if it has one, else its image.

    Args:
        style_encoder: The space; the framework passes the one that is configured.
        size: Side that images are squashed to before, bicubic; none leaves that to the encoder.
    """

    better: ClassVar[Mapping[str, str]] = {"clip_direction": "higher"}
    higher_is_better = True

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
        styles, given = wanted(encoder, comparison, self.size)
        directions = F.normalize(styles - neutral_embedding(encoder).to(styles), dim=-1)

        def cosine(row: int) -> Tensor:
            content, stylized = comparison.content[row], comparison.stylized[row]
            before = embed(encoder, content, fingerprints(content), self.size)
            after = embed(encoder, stylized, fingerprints(stylized), self.size)
            return (F.normalize(after - before, dim=-1) @ directions[row]).mean()

        return row_by_row(comparison, given, cosine)
