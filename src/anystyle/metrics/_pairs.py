"""Pairs of a comparison for metrics of images, in batches, and means over the rows."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.perception.feature_cache import batch_size
from anystyle.perception.preprocess import checked, finite
from anystyle.types import Comparison


class Pairs(NamedTuple):
    """Views of one row of a comparison."""

    row: int
    preds: Float[Tensor, "M 3 H W"]
    target: Float[Tensor, "M 3 H W"]


def pairs(comparison: Comparison) -> Iterator[Pairs]:
    """All pairs of a comparison, row by row in batches that a network processes at once."""
    for row, views in enumerate(zip(comparison.stylized, comparison.content, strict=True)):
        for preds, target in zip(*(images.split(batch_size(images)) for images in views), strict=True):
            yield Pairs(row, preds, target)


def with_style_images(comparison: Comparison) -> tuple[Comparison, Float[Tensor, "R 3 h w"]]:
    """The rows of a comparison that have a style image, and these images; checked.

    Raises:
        ValueError: No row has one, or images are not finite or not of one size.
    """
    style = checked(comparison).style
    if style is None or style.image is None or (style.has_image is not None and not bool(style.has_image.any())):
        raise ValueError("the comparison has no style image; this metric compares with one: give style images")
    if style.has_image is not None and not bool(style.has_image.all()):
        given = style.has_image
        comparison = comparison.map(lambda tensor: tensor[given.to(tensor.device)])
        comparison = replace(comparison, scenes=_kept(comparison.scenes, given), styles=_kept(comparison.styles, given))
        return comparison, finite(style.image[given.to(style.image.device)], "the style images")
    return comparison, finite(style.image, "the style images")


def _kept(names: tuple[str, ...], rows: Bool[Tensor, " B"]) -> tuple[str, ...]:
    return tuple(name for name, kept in zip(names, rows.tolist(), strict=True) if kept) if names else ()


def mean_per_row(comparison: Comparison, value: Callable[[Pairs], Float[Tensor, " M"]]) -> Float[Tensor, " R"]:
    """The mean over each row's views, in float64, of ``value``, which returns a number for each pair."""
    rows: dict[int, list[Tensor]] = {}
    for batch in pairs(comparison):
        rows.setdefault(batch.row, []).append(value(batch))
    return torch.stack([torch.cat(values).double().mean() for values in rows.values()])
