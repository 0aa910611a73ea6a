"""Cosines in a style encoder's space: how close images come to the style, and whether they change towards it."""

from collections.abc import Mapping
from typing import ClassVar, final

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import StyleEncoder, neutral_embedding
from anystyle.errors import UserError
from anystyle.losses.features import resized
from anystyle.metrics.base import RowMean
from anystyle.types import Comparison
from anystyle.vision.feature_cache import CACHE, identity


class ClipStyle(RowMean):
    """Cosine of ``E(stylized)`` and ``E(style)``, averaged over views, in [-1, 1].

    A style's text counts if it has one, else its image.

    Args:
        size: Side that images are squashed to before, bicubic; none leaves that to the encoder.

    Example:
        >>> images = torch.rand(1, 3, 32, 32)
        >>> metric = ClipStyle(style_encoder=inputs.style_encoder(), size=None)
        >>> metric.update(images, images)  # the result is the style image
        >>> print(f"{metric.compute():.3f}")
        1.000
    """

    better: ClassVar[Mapping[str, str]] = {"clip_style": "higher"}
    takes = ("preds", "style")

    def __init__(self, *, style_encoder: StyleEncoder, size: int | None = 224) -> None:
        super().__init__()
        # In a tuple: the encoder's weights are not part of this module.
        self._encoder = (style_encoder,)
        self.size = size

    @property
    def encoder(self) -> StyleEncoder:
        """The style encoder."""
        return self._encoder[0]

    def of_views(self, comparison: Comparison, row: int) -> Float[Tensor, "V D"]:
        """What is compared of the views of a row."""
        return self.embed(comparison.stylized[row])

    def of_styles(self, styles: Float[Tensor, "B D"]) -> Float[Tensor, "B D"]:
        """What is compared of the embeddings of styles."""
        return styles

    @final
    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        styles, given = self._embed_styles(comparison)
        target = F.normalize(self.of_styles(styles), dim=-1)
        rows = given.nonzero().flatten().tolist()
        cosines = [(F.normalize(self.of_views(comparison, row), dim=-1) @ target[row]).mean() for row in rows]
        return torch.stack(cosines).double() if cosines else torch.zeros(0, dtype=torch.float64)

    def embed(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Embeddings of images, each computed once."""

        def compute(batch: Tensor) -> list[Tensor]:
            return [self.encoder.embed_images(resized(batch, self.size, "bicubic"))]

        return CACHE.features(images, ("style encoder", identity(self.encoder), self.size), compute)[0]

    def _embed_styles(self, comparison: Comparison) -> tuple[Float[Tensor, "B D"], Bool[Tensor, " B"]]:
        """The embedding of each row's style, of its text if it has one, else of its image; and which rows have one."""
        style, num_rows = comparison.style, comparison.content.shape[0]
        if style is None or (style.image is None and style.text is None):
            raise UserError("the comparison has no style; give style images or texts")
        given = torch.zeros(num_rows, dtype=torch.bool, device=comparison.stylized.device)
        vectors = comparison.stylized.new_zeros(num_rows, self.encoder.dim)
        if style.image is not None:
            given = given | (style.has_image.to(given.device) if style.has_image is not None else True)
            if bool(given.any()):
                vectors[given] = self.embed(style.image[given])
        for row, text in enumerate(style.text or ()):
            if text:
                vectors[row] = self.encoder.embed_texts([text])[0]
                given[row] = True
        return vectors, given


class ClipDirection(ClipStyle):
    """Cosine of ``E(stylized) - E(photograph)`` and ``E(style) - E(neutral)`` (StyleGAN-NADA, Gal et al. 2022).

    Averaged over views, in [-1, 1]. A style's text counts if it has one, else its image.

    Example:
        >>> images = torch.rand(1, 3, 32, 32)
        >>> metric = ClipDirection(style_encoder=inputs.style_encoder(), size=None)
        >>> metric.update(images, images, ["waves"])  # nothing changed
        >>> float(metric.compute())
        0.0
    """

    better: ClassVar[Mapping[str, str]] = {"clip_direction": "higher"}
    takes = ("preds", "target", "style")

    def of_views(self, comparison: Comparison, row: int) -> Float[Tensor, "V D"]:
        return super().of_views(comparison, row) - self.embed(comparison.content[row])

    def of_styles(self, styles: Float[Tensor, "B D"]) -> Float[Tensor, "B D"]:
        return styles - neutral_embedding(self.encoder).to(styles)
