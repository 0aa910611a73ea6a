"""What metrics that run frozen networks share: their weights on record, and features that are computed once."""

from abc import ABC
from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar, Literal, final

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics.utilities import dim_zero_cat

from anystyle.contracts import Metric
from anystyle.metrics._pairs import Pairs, RowMean, mean_per_row
from anystyle.perception import lpips, preprocess
from anystyle.perception.embeddings import SourcedNetwork
from anystyle.perception.feature_cache import CACHE
from anystyle.perception.lpips import Lpips
from anystyle.perception.sources import Source, Weights, checksums, stand_ins
from anystyle.types import Comparison


class NetworkMetric(Metric, ABC):
    """A metric whose figures rest on published weights or on stand-ins.

    Args:
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    full_state_update = False

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"weights": "stand_in"}

    def declare(self, *sources: Source, figures: Iterable[str] = ()) -> None:
        """Record what figures rest on.

        Args:
            sources: The weights of networks.
            figures: Names of the figures that these networks compute; all if empty.
        """
        self.stand_ins = {**self.stand_ins, **stand_ins(figures or self.better, *sources)}
        self.weights = {**self.weights, **checksums(*sources)}


def image_vectors(
    network: SourcedNetwork, images: Float[Tensor, "M 3 H W"], *, size: int, rounded: bool
) -> Float[Tensor, "M D"]:
    """A network's vectors of images, each image resized and embedded once.

    Args:
        network: The network.
        images: sRGB in [0, 1].
        size: Of the shorter side, in pixels.
        rounded: Whether images have 8 bits before and after they are resized, as files.
    """

    def embed(batch: Tensor) -> list[Tensor]:
        return [network(preprocess.resized(batch, size, rounded=rounded))]

    return CACHE.features(images, ("vectors", network.source.identity, size, rounded), embed)[0]


def lpips_of_pairs(
    network: Lpips, batch: Pairs, *, size: int | None, rounded: bool, gray: bool = False
) -> Float[Tensor, " M"]:
    """LPIPS of stylized images and photographs.

    Args:
        network: LPIPS.
        batch: The pairs.
        size: Of the shorter side, in pixels; ``None`` keeps it.
        rounded: Whether images have 8 bits before and after they are resized, as files.
        gray: Whether colour is removed.
    """

    def prepared(images: Tensor) -> Tensor:
        if size is not None:
            images = preprocess.resized(images, size, rounded=rounded)
        elif rounded:
            images = preprocess.eight_bit(images)
        return preprocess.gray(images, rounded=rounded) if gray else images

    def distances() -> Tensor:
        target = CACHE.features(batch.target, ("lpips maps", *key), lambda images: network.describe(prepared(images)))
        return network.compare(network.describe(prepared(batch.preds)), target)

    key = (network.source.identity, size, rounded, gray)
    return CACHE.scores(batch.preds, batch.target, ("lpips", *key), distances)


class LpipsMean(NetworkMetric, RowMean):
    """Mean LPIPS of stylized images and photographs.

    Args:
        backbone: Of the distance; the published evaluation takes ``alex`` here.
        size: Pixels of the shorter side that images are resized to; none keeps theirs.
        variant: ``reference`` has images of 8 bits before and after they are resized, as the published script has
            them from files; ``corrected`` rounds nothing.
    """

    gray: ClassVar[bool]
    """Whether colour is removed before."""

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

    @final
    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        return mean_per_row(comparison, self._distances)

    def _distances(self, batch: Pairs) -> Float[Tensor, " M"]:
        return lpips_of_pairs(self.network, batch, size=self.size, rounded=self.rounded, gray=self.gray)


def stacked(state: list[Tensor] | Tensor) -> Float[Tensor, "N D"]:
    """The rows of a list state, which a reduction over processes has made one tensor; none before any update."""
    return dim_zero_cat(state) if len(state) else torch.zeros(0, 1)
