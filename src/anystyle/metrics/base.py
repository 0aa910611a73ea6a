"""What metrics share: pairs of images in batches, means over rows, and frozen networks with their weights on record."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, NamedTuple, final

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor
from torchmetrics.utilities import dim_zero_cat

from anystyle.contracts import Metric, accepts_tensors
from anystyle.errors import UserError
from anystyle.types import Comparison, Source
from anystyle.types.network import checksums, stand_ins
from anystyle.vision.feature_cache import batch_size


class Pairs(NamedTuple):
    """Views of some rows of a comparison."""

    rows: Int[Tensor, " M"]
    preds: Float[Tensor, "M 3 H W"]
    target: Float[Tensor, "M 3 H W"]


def pairs(comparison: Comparison) -> Iterator[Pairs]:
    """All pairs of a comparison, row by row, in batches that a network processes at once."""
    num_rows, views = comparison.stylized.shape[:2]
    size = batch_size(comparison.stylized[0])
    together = max(1, size // max(1, views))
    for start in range(0, num_rows, together):
        some = slice(start, start + together)
        rows = torch.arange(num_rows)[some].repeat_interleave(views)
        parts = (rows, comparison.stylized[some].flatten(0, 1), comparison.content[some].flatten(0, 1))
        yield from map(Pairs, *(part.split(size) for part in parts))


def with_style_images(comparison: Comparison) -> tuple[Comparison, Float[Tensor, "R 3 h w"]]:
    """The rows of a comparison that have a style image, and these images."""
    style = comparison.style
    given = None if style is None else style.has_image
    if style is None or style.image is None or (given is not None and not bool(given.any())):
        raise UserError("the comparison has no style image; this metric compares with one: give style images")
    image = style.image
    if given is not None and not bool(given.all()):
        kept = given.nonzero().flatten().tolist()
        scenes, styles = (
            tuple(names[row] for row in kept if names) for names in (comparison.scenes, comparison.styles)
        )
        comparison = replace(comparison.map(lambda tensor: tensor[kept]), scenes=scenes, styles=styles)
        image = image[kept]
    return comparison, image


def mean_per_row(comparison: Comparison, value: Callable[[Pairs], Float[Tensor, " M"]]) -> Float[Tensor, " R"]:
    """The mean over each row's views, in float64, of ``value``, which returns a number for each pair."""
    values = torch.cat([value(batch) for batch in pairs(comparison)])
    return values.double().view(comparison.stylized.shape[:2]).mean(1)


class RowMean(Metric, ABC):
    """A metric with one score, the mean of one number per row: each style of each scene counts equally.

    A row's number that is ``nan`` is left out. ``lacking`` is the warning where no row had a number.
    """

    lacking: ClassVar[str] = "no image that can be judged"
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
    @accepts_tensors
    def update(self, comparison: Comparison) -> None:
        values = self.of_rows(comparison)
        values = values[~values.isnan()].to(self.total)
        self.total += values.sum()
        self.rows += values.numel()

    @final
    def compute(self) -> Tensor:
        (name,) = self.better
        if int(self.rows) == 0:
            warnings.warn(f"{name}: {self.lacking}; the score is nan", stacklevel=2)
        return (self.total / self.rows).float()  # nan where there is no row


class NetworkMetric(Metric, ABC):
    """A metric whose scores rest on published weights or on stand-ins."""

    full_state_update = False

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"weights": "stand_in"}

    def name_after(self, distance: str) -> None:
        """Give scores called by LPIPS the name of the distance that replaces it, before any is declared."""
        vars(self)["better"] = {name.replace("lpips", distance): way for name, way in type(self).better.items()}

    def declare(self, *sources: Source, scores: Iterable[str] = ()) -> None:
        """Record the weights that scores rest on; all scores if none is named."""
        self.stand_ins = {**self.stand_ins, **stand_ins(scores or self.better, *sources)}
        self.weights = {**self.weights, **checksums(*sources)}


def stacked(state: list[Tensor] | Tensor) -> Shaped[Tensor, " N *shape"]:
    """The rows of a list state, which a reduction over processes has made one tensor; none before any update."""
    return dim_zero_cat(state) if len(state) else torch.zeros(0, 1, 1)
