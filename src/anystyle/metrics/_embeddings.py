"""Embeddings of images and styles in a style encoder's space, each image embedded once."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.perception.memo import MEMO, fingerprints, identity
from anystyle.types import Comparison


def embed(
    encoder: StyleEncoder, images: Float[Tensor, "M 3 H W"], marks: list[str], size: int | None
) -> Float[Tensor, "M D"]:
    """Embeddings of images, squashed to a square before unless ``size`` is none; bicubic, as published."""

    def look(some: Tensor) -> list[Tensor]:
        if size is not None and some.shape[-2:] != (size, size):
            some = F.interpolate(some, size=(size, size), mode="bicubic", align_corners=False)
        return [encoder.embed_images(some)]

    return MEMO.rows(images, marks, ("style encoder", identity(encoder), size), look)[0]


def wanted(
    encoder: StyleEncoder, comparison: Comparison, size: int | None
) -> tuple[Float[Tensor, "B D"], Bool[Tensor, " B"]]:
    """The embedding of each row's style, of its text if there is one and else of its image; and which rows have one.

    Raises:
        ValueError: There is no style at all.
    """
    style, count = comparison.style, comparison.content.shape[0]
    if style is None or (style.image is None and style.text is None):
        raise ValueError("the comparison has no style; give style images or texts")
    given = torch.zeros(count, dtype=torch.bool, device=comparison.stylized.device)
    vectors = comparison.stylized.new_zeros(count, encoder.dim)
    if style.image is not None:
        rows = style.has_image if style.has_image is not None else torch.ones(count, dtype=torch.bool)
        rows = rows.to(given.device)
        if bool(rows.any()):
            images = style.image[rows]
            vectors[rows] = embed(encoder, images, fingerprints(images), size)
        given = given | rows
    for row, text in enumerate(style.text or ()):
        if text:
            vectors[row] = encoder.embed_texts([text])[0]
            given[row] = True
    return vectors, given


def row_by_row(comparison: Comparison, given: Bool[Tensor, " B"], value: Callable[[int], Tensor]) -> Tensor:
    """One number a row that has a style, in float64."""
    rows = [value(row).double() for row in range(comparison.content.shape[0]) if bool(given[row])]
    return torch.stack(rows) if rows else torch.zeros(0, dtype=torch.float64)
