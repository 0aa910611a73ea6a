"""LPIPS: how much content was changed, as a network sees it."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._mean import RowMean
from anystyle.metrics._networks import NetworkMetric, lpips_of_pairs
from anystyle.metrics._pairs import mean_per_row
from anystyle.perception import lpips
from anystyle.perception.sources import Weights
from anystyle.types import Comparison


class LPIPS(NetworkMetric, RowMean):
    """LPIPS of stylized images and photographs (Zhang et al. 2018; eval_artfid.py).

    Args:
        backbone: Of the distance; the published evaluation takes ``alex`` here.
        size: Pixels of the shorter side that images are resized to; none keeps theirs.
        variant: ``reference`` has images of 8 bits before and after they are resized, as the published script has
            them from files; ``corrected`` rounds nothing.
    """

    better: ClassVar[Mapping[str, str]] = {"lpips": "lower"}

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
        self.declare(self.network.source)

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        return mean_per_row(
            comparison, lambda batch: lpips_of_pairs(self.network, batch, size=self.size, rounded=self.rounded)
        )
