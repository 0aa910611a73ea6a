"""Metrics that are one number a row, averaged over rows."""

import warnings
from abc import ABC, abstractmethod
from typing import ClassVar, final

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.perception.preprocess import checked
from anystyle.types import Comparison


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
