"""Embeddings of images and styles in a style encoder's space; each image is embedded once."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.perception.feature_cache import CACHE, identity
from anystyle.types import Comparison


def embed(encoder: StyleEncoder, images: Float[Tensor, "M 3 H W"], size: int | None) -> Float[Tensor, "M D"]:
    """Embeddings of images, squashed to a square before unless ``size`` is ``None``; bicubic, as published."""

    def compute(batch: Tensor) -> list[Tensor]:
        if size is not None and batch.shape[-2:] != (size, size):
            batch = F.interpolate(batch, size=(size, size), mode="bicubic", align_corners=False)
        return [encoder.embed_images(batch)]

    return CACHE.features(images, ("style encoder", identity(encoder), size), compute)[0]


def embed_styles(
    encoder: StyleEncoder, comparison: Comparison, size: int | None
) -> tuple[Float[Tensor, "B D"], Bool[Tensor, " B"]]:
    """The embedding of each row's style, of its text if there is one and else of its image; and which rows have one.

    Raises:
        ValueError: There is no style at all.
    """
    style, num_rows = comparison.style, comparison.content.shape[0]
    if style is None or (style.image is None and style.text is None):
        raise ValueError("the comparison has no style; give style images or texts")
    given = torch.zeros(num_rows, dtype=torch.bool, device=comparison.stylized.device)
    vectors = comparison.stylized.new_zeros(num_rows, encoder.dim)
    if style.image is not None:
        given = given | (style.has_image.to(given.device) if style.has_image is not None else True)
        if bool(given.any()):
            vectors[given] = embed(encoder, style.image[given], size)
    for row, text in enumerate(style.text or ()):
        if text:
            vectors[row] = encoder.embed_texts([text])[0]
            given[row] = True
    return vectors, given


def of_given_rows(given: Bool[Tensor, " B"], value: Callable[[int], Tensor]) -> Float[Tensor, " R"]:
    """One number for each row that has a style, in float64."""
    rows = [value(row).double() for row in given.nonzero().flatten().tolist()]
    return torch.stack(rows) if rows else torch.zeros(0, dtype=torch.float64)
