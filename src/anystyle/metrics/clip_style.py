"""CLIP style: how close stylized images are, in the encoder's space, to the style."""

from collections.abc import Mapping
from typing import ClassVar

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.metrics._embeddings import embed, row_by_row, wanted
from anystyle.metrics._mean import RowMean
from anystyle.perception.memo import fingerprints
from anystyle.types import Comparison


class ClipStyle(RowMean):
    """Cosine of ``E(stylized)`` and ``E(style)``, averaged over views, in [-1, 1].

    A style's text counts if it has one, else its image.

    Args:
        style_encoder: The space; the framework passes the one that is configured.
        size: Side that images are squashed to before, bicubic; none leaves that to the encoder.
    """

    better: ClassVar[Mapping[str, str]] = {"clip_style": "higher"}
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
        styles = F.normalize(styles, dim=-1)

        def cosine(row: int) -> Tensor:
            stylized = comparison.stylized[row]
            found = embed(encoder, stylized, fingerprints(stylized), self.size)
            return (F.normalize(found, dim=-1) @ styles[row]).mean()

        return row_by_row(comparison, given, cosine)
