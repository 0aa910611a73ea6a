"""ArtScore: how much stylized images look like fine art to a network trained to rank (Chen et al. 2024)."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import NetworkMetric, Pairs, RowMean, mean_per_row
from anystyle.types import Comparison
from anystyle.vision import embeddings, preprocess
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.weights import Weights

SIZE = 224


class ArtScore(NetworkMetric, RowMean):
    """The raw score, unbounded, of stylized images (eval_artscore_consistency_from_stylos.py).

    Args:
        variant: ``reference`` resizes the shorter side to 224, in 8 bits; ``corrected`` resizes to a square of 224, as
            the network's authors do.
        weights: ``auto`` falls back to a stand-in, with a warning, where the published ones are missing.

    Example:
        >>> images = torch.ones(1, 2, 3, 32, 32)
        >>> metric, one = ArtScore(weights="stand_in"), ArtScore(weights="stand_in")
        >>> metric.update(images)
        >>> one.update(images[:, :1])
        >>> float(metric.compute() - one.compute())  # the mean over views
        0.0
    """

    better: ClassVar[Mapping[str, str]] = {"art_score": "higher"}
    takes = ("preds",)

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference", weights: Weights = "auto") -> None:
        super().__init__()
        self.reference = variant == "reference"
        self.network = embeddings.load_art_score(weights)
        self.declare(self.network.source)

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        return mean_per_row(comparison, self._scores)

    def _scores(self, batch: Pairs) -> Float[Tensor, " M"]:
        key = ("art_score", self.network.source.identity, self.reference)

        def score(images: Tensor) -> list[Tensor]:
            if self.reference:
                return [self.network(preprocess.resized(images, SIZE, rounded=True))]
            return [self.network(preprocess.as_pillow(images, (SIZE, SIZE)))]

        return CACHE.features(batch.preds, key, score)[0]
