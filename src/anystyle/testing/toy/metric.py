"""How much changed: the smallest metric."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.types import Comparison


class ToyMetric(Metric):
    """The mean absolute difference between photographs and results, over all their pixels."""

    better: ClassVar[Mapping[str, str]] = {"change": "lower"}
    full_state_update = False

    total: Tensor
    count: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.add_state("total", torch.tensor(0.0), dist_reduce_fx="sum")
        self.add_state("count", torch.tensor(0), dist_reduce_fx="sum")

    def update(self, comparison: Comparison) -> None:
        change = (comparison.stylized - comparison.content).abs()
        self.total = self.total + change.sum()
        self.count = self.count + change.numel()

    def compute(self) -> Tensor:
        return self.total / self.count  # nan where nothing was taken in
