"""LPIPS without colour: how much content was changed, as a network sees it."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.metrics._lpips import pair_lpips
from anystyle.metrics._pairs import checked, gathered, mean_of
from anystyle.perception import lpips
from anystyle.perception.sources import Weights, checksums, stand_ins
from anystyle.types import Comparison


class LPIPSGray(Metric):
    """LPIPS of stylized images and photographs, both without colour, so that a palette costs nothing.

    Args:
        backbone: Of the distance; the published evaluation takes ``alex`` here.
        size: Pixels of the shorter side that images are resized to; none keeps theirs.
        variant: ``reference`` has images of 8 bits before and after they are resized, as the published script has
            them from files; ``corrected`` rounds nothing.
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {"lpips_gray": "lower"}
    higher_is_better = False
    is_differentiable = False
    full_state_update = False
    total: Tensor
    rows: Tensor

    def __init__(
        self,
        *,
        backbone: Literal["alex", "vgg"] = "alex",
        size: int | None = 512,
        variant: Literal["reference", "corrected"] = "reference",
        weights: Weights = "auto",
    ) -> None:
        super().__init__()
        self.size = size
        self.rounded = variant == "reference"
        self.network = lpips.load(backbone, weights)
        self.stand_ins = stand_ins(self.better, self.network.source)
        self.weights = checksums(self.network.source)
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros((), dtype=torch.long), dist_reduce_fx="sum")

    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        """See :meth:`anystyle.contracts.Metric.update`."""
        found = gathered(
            checked(comparison),
            lambda some: pair_lpips(self.network, some, size=self.size, rounded=self.rounded, gray=True),
        )
        self.total += found.sum()
        self.rows += found.numel()

    def compute(self) -> dict[str, Tensor]:
        """See :meth:`anystyle.contracts.Metric.compute`."""
        return {"lpips_gray": mean_of(self.total, self.rows, "lpips_gray")}
