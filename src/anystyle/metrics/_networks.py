"""What metrics that run frozen networks share: their weights on record, and features that are computed once."""

from abc import ABC
from collections.abc import Iterable
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics.utilities import dim_zero_cat

from anystyle.contracts import Metric
from anystyle.metrics._pairs import Pairs
from anystyle.perception import preprocess
from anystyle.perception.embeddings import SourcedNetwork
from anystyle.perception.feature_cache import CACHE
from anystyle.perception.lpips import Lpips
from anystyle.perception.sources import Source, checksums, stand_ins


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


def stacked(state: list[Tensor] | Tensor) -> Float[Tensor, "N D"]:
    """The rows of a list state, which a reduction over processes has made one tensor; none before any update."""
    return dim_zero_cat(state) if len(state) else torch.zeros(0, 1)
