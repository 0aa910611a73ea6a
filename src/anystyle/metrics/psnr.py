"""PSNR: how far stylized images are from the photographs, in decibels."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.metrics._pairs import Pairs, checked, gathered, mean_of
from anystyle.types import Comparison


class PSNR(Metric):
    """Peak signal-to-noise ratio of reconstructions: the mean over images of ``-10 log10 MSE``.

    Args:
        most: Where the ratio of an image is cut off, in decibels: equal images would be infinitely good.
    """

    better: ClassVar[Mapping[str, str]] = {"psnr": "higher"}
    higher_is_better = True
    is_differentiable = False
    full_state_update = False
    total: Tensor
    rows: Tensor

    def __init__(self, *, most: float = 100.0) -> None:
        super().__init__()
        if most <= 0:
            raise ValueError(f"psnr.most is {most}; it must be positive")
        self.most = most
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros((), dtype=torch.long), dist_reduce_fx="sum")

    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        """See :meth:`anystyle.contracts.Metric.update`."""
        found = gathered(checked(comparison), self._decibels)
        self.total += found.sum()
        self.rows += found.numel()

    def compute(self) -> dict[str, Tensor]:
        """See :meth:`anystyle.contracts.Metric.compute`."""
        return {"psnr": mean_of(self.total, self.rows, "psnr")}

    def _decibels(self, some: Pairs) -> Float[Tensor, " M"]:
        error = (some.stylized - some.content).double().square().mean((1, 2, 3))
        return (-10 * error.log10()).clamp_max(self.most)
