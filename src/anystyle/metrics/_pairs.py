"""What metrics of image pairs share: walking through a comparison, each image once, and means over rows."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.perception import pictures
from anystyle.perception.memo import batch_of, fingerprints
from anystyle.types import Comparison


class Pairs(NamedTuple):
    """Some views of one row: a photograph beside what became of it.

    Args:
        row: Of the comparison.
        content: The photographs.
        content_marks: Their fingerprints.
        stylized: The results.
        stylized_marks: Their fingerprints.
    """

    row: int
    content: Float[Tensor, "M 3 H W"]
    content_marks: list[str]
    stylized: Float[Tensor, "M 3 H W"]
    stylized_marks: list[str]


def checked(comparison: Comparison) -> Comparison:
    """A comparison whose images are numbers and of one size.

    Raises:
        ValueError: They are not.
    """
    if comparison.content.shape != comparison.stylized.shape:
        raise ValueError(
            f"photographs are {list(comparison.content.shape)} and stylized images {list(comparison.stylized.shape)}; "
            "give as many of one size"
        )
    content = comparison.content
    pictures.finite(content[:1] if content.stride(0) == 0 else content, "the photographs")
    pictures.finite(comparison.stylized, "the stylized images")
    return comparison


def pairs(comparison: Comparison) -> Iterator[Pairs]:
    """All pairs of a comparison, in parts that a network is shown at once; photographs are marked once."""
    content, stylized = comparison.content, comparison.stylized
    shared = content.shape[0] > 1 and content.stride(0) == 0
    marks: list[str] = []
    for row in range(content.shape[0]):
        if row == 0 or not shared:
            marks = fingerprints(content[row])
        count = batch_of(content[row])
        for start in range(0, content.shape[1], count):
            part = slice(start, start + count)
            some = stylized[row, part]
            yield Pairs(row, content[row, part], marks[part], some, fingerprints(some))


def style_images(comparison: Comparison) -> tuple[Float[Tensor, "B 3 h w"], Bool[Tensor, " B"]]:
    """The style images of a comparison, and which rows have one.

    Raises:
        ValueError: No row has one, or one holds no numbers.
    """
    style = comparison.style
    if style is None or style.image is None or (style.has_image is not None and not bool(style.has_image.any())):
        raise ValueError("the comparison has no style image; this metric compares with one: give style images")
    rows = style.image.shape[0]
    given = style.has_image if style.has_image is not None else torch.ones(rows, dtype=torch.bool)
    given = given.to(style.image.device)
    pictures.finite(style.image[given], "the style images")
    return style.image, given


def row_means(rows: Mapping[int, list[Tensor]]) -> Float[Tensor, " R"]:
    """The mean of each row's values, in float64 and in the order of the rows."""
    return torch.stack([torch.cat(rows[row]).double().mean() for row in sorted(rows)])


def gathered(comparison: Comparison, value: Callable[[Pairs], Float[Tensor, " M"]]) -> Float[Tensor, " R"]:
    """One number a row: the mean over its views of what ``value`` says of each pair."""
    rows: dict[int, list[Tensor]] = {}
    for some in pairs(comparison):
        rows.setdefault(some.row, []).append(value(some))
    return row_means(rows)


def mean_of(total: Tensor, count: Tensor, name: str) -> Float[Tensor, ""]:
    """A sum divided by its count; ``nan`` with a warning where the count is 0."""
    if int(count) == 0:
        warnings.warn(f"{name}: nothing to average; the figure is nan", stacklevel=3)
        return torch.full((), float("nan"), device=total.device)
    return (total / count).float()
