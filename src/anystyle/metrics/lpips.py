"""LPIPS: how much content was changed, as a network sees it."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._lpips import pair_lpips
from anystyle.metrics._mean import RowMean
from anystyle.metrics._pairs import gathered
from anystyle.perception import lpips
from anystyle.perception.sources import Weights, checksums, stand_ins
from anystyle.types import Comparison


class LPIPS(RowMean):
    """LPIPS of stylized images and photographs (Zhang et al. 2018; eval_artfid.py).

    Args:
        backbone: Of the distance; the published evaluation takes ``alex`` here.
        size: Pixels of the shorter side that images are resized to; none keeps theirs.
        variant: ``reference`` has images of 8 bits before and after they are resized, as the published script has
            them from files; ``corrected`` rounds nothing.
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {"lpips": "lower"}
    higher_is_better = False

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

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Stand-ins: quick, and the same everywhere."""
        return {"weights": "stand_in"}

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views."""
        return gathered(
            comparison,
            lambda some: pair_lpips(self.network, some, size=self.size, rounded=self.rounded, gray=False),
        )
