"""Metrics that each break one promise, and what is found."""

from typing import ClassVar

import torch

from anystyle.testing.toy.metric import ToyMetric


class Undeclared(ToyMetric):
    better: ClassVar = {"other": "lower"}


class Sideways(ToyMetric):
    better: ClassVar = {"change": "sideways"}


class ANumber(ToyMetric):
    def compute(self):
        return {"change": float(super().compute()["change"])}


class Zero(ToyMetric):
    def compute(self):
        return {"change": super().compute()["change"].nan_to_num(0)}


class Attribute(ToyMetric):
    def __init__(self):
        super().__init__()
        self.seen = 0

    def update(self, comparison):
        super().update(comparison)
        self.seen += 1

    def compute(self):
        return {"change": super().compute()["change"] * self.seen / max(self.seen, 1) + 0.01 * (self.seen > 3)}


class LastCounts(ToyMetric):
    def update(self, comparison):
        self.total = self.total * 0.5
        super().update(comparison)


class Pinned(ToyMetric):
    def __init__(self):
        super().__init__()
        self.change = lambda comparison: (comparison.stylized - comparison.content).abs()


class Unmergeable(ToyMetric):
    def __init__(self):
        super().__init__()
        self.add_state("count", torch.tensor(0), dist_reduce_fx="max")


class Overwriting(ToyMetric):
    def update(self, comparison):
        super().update(comparison)
        comparison.stylized.clamp_(0.2, 0.8)


CHANGED = {
    "as it is": (ToyMetric, set()),
    "another name": (Undeclared, {"figures are declared"}),
    "neither higher nor lower": (Sideways, {"figures are declared"}),
    "no tensor": (ANumber, {"figures are declared"}),
    "0 for nothing": (Zero, {"too little is not an error"}),
    "what reset does not know": (Attribute, {"reset forgets"}),
    "the last counts more": (
        LastCounts,
        {"order does not matter", "processes can be merged"},
    ),
    "a lambda": (Pinned, {"copies go on"}),
    "counts that are not summed": (Unmergeable, {"processes can be merged"}),
    "results overwritten": (Overwriting, {"inputs are left alone", "copies go on"}),
}
