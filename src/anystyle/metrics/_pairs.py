"""Pairs of a comparison for metrics of images, in batches; and metrics that are the mean of one number a row."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import ClassVar, NamedTuple, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import Metric
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


class RowMean(Metric, ABC):
    """A metric with one figure, the mean of one number a row: each style of each scene counts alike.

    A row's number that is ``nan`` is left out.

    Attributes:
        lacking: What to say where no row had a number.
    """

    lacking: ClassVar[str] = "nothing that can be judged was taken in"
    full_state_update = False
    total: Tensor
    rows: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros((), dtype=torch.long), dist_reduce_fx="sum")

    @abstractmethod
    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """One number for each row that can be judged."""

    @final
    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        values = self.of_rows(checked(comparison))
        values = values[~values.isnan()].to(self.total)
        self.total += values.sum()
        self.rows += values.numel()

    @final
    def compute(self) -> dict[str, Tensor]:
        (name,) = self.better
        if int(self.rows) == 0:
            warnings.warn(f"{name}: {self.lacking}; the figure is nan", stacklevel=2)
            return {name: torch.full((), float("nan"), device=self.total.device)}
        return {name: (self.total / self.rows).float()}
