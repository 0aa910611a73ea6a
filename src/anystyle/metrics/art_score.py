"""ArtScore: how much stylized images look like fine art to a network that was taught to rank (Chen et al. 2024)."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._mean import RowMean
from anystyle.metrics._pairs import Pairs, gathered
from anystyle.perception import pictures, vectors
from anystyle.perception.memo import MEMO
from anystyle.perception.sources import Weights, checksums, stand_ins
from anystyle.types import Comparison

SIZE = 224


class ArtScore(RowMean):
    """The raw score, unbounded, of stylized images (eval_artscore_consistency_from_stylos.py).

    Args:
        variant: ``reference`` resizes the shorter side to 224, in 8 bits; ``corrected`` resizes to a square of 224, as
            the network's authors do.
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {"art_score": "higher"}
    higher_is_better = True

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference", weights: Weights = "auto") -> None:
        super().__init__()
        self.reference = variant == "reference"
        self.network = vectors.load_art_score(weights)
        self.stand_ins = stand_ins(self.better, self.network.source)
        self.weights = checksums(self.network.source)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Stand-ins: quick, and the same everywhere."""
        return {"weights": "stand_in"}

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views."""
        return gathered(comparison, self._scores)

    def _scores(self, some: Pairs) -> Float[Tensor, " M"]:
        what = ("art_score", self.network.source.identity, self.reference)
        return MEMO.rows(some.stylized, some.stylized_marks, what, lambda x: [self.network(self._prepared(x))])[0]

    def _prepared(self, images: Tensor) -> Tensor:
        if self.reference:
            return pictures.resized(images, SIZE, rounded=True)
        return pictures.as_pillow(images, (SIZE, SIZE))
