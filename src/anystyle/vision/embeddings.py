"""Networks that map a whole image to a vector, for FID and KID, or to a score; with stand-ins."""

from collections.abc import Callable
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.types import Source
from anystyle.vision import art_score, inception, networks
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.features import Frozen, freeze
from anystyle.vision.lpips import STAND_IN_LAYERS, STAND_IN_SIDE
from anystyle.vision.preprocess import resized, shrunk
from anystyle.vision.statistics import pooled_moments
from anystyle.vision.weights import Weights, bundled, locate, published


class SourcedNetwork(Frozen):
    """A network from images in [0, 1], shrunk to a longest side, to a vector or a score, with its weights' source."""

    def __init__(self, network: nn.Module, source: Source, longest: int | None = None) -> None:
        super().__init__()
        self.network, self.source, self.longest = network, source, longest

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M *D"]:
        return self.network(shrunk(images, self.longest))

    def vectors(self, images: Float[Tensor, "M 3 H W"], *, size: int, rounded: bool) -> Float[Tensor, " M *D"]:
        """The outputs for images, computed once each; ``size`` and ``rounded`` as for ``preprocess.resized``."""
        key = (self.source.identity, size, rounded)
        return CACHE.features(images, key, lambda batch: [self(resized(batch, size, rounded=rounded))])[0]


class TextureMoments(Frozen):
    """Mean and deviation of every channel of the bundled texture network: 640 numbers."""

    def __init__(self) -> None:
        super().__init__()
        self.network = networks.load("texture")

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 640"]:
        return torch.cat([pooled_moments(features) for features in self.network(images, STAND_IN_LAYERS)], dim=1)


class TextureScore(TextureMoments):
    """The product of :class:`TextureMoments` with a fixed random direction: a number that does not measure art."""

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        drawn = torch.randn(640, generator=torch.Generator().manual_seed(0))
        return super().forward(images) @ F.normalize(drawn, dim=0).to(images)


def load_art_inception(choice: Weights = "auto") -> SourcedNetwork:
    """The network of ArtFID, or its stand-in."""
    return _load("art_inception", choice, inception.load, TextureMoments, "texture_moments")


def load_art_score(choice: Weights = "auto") -> SourcedNetwork:
    """The network of ArtScore, or its stand-in."""
    return _load("art_score", choice, art_score.load, TextureScore, "texture_score")


def _load(
    name: str, choice: Weights, load: Callable[[Path], Frozen], other: type[TextureMoments], stand_in: str
) -> SourcedNetwork:
    if (file := locate(name, choice)) is not None:
        return SourcedNetwork(load(file), published(name, file))
    return freeze(SourcedNetwork(other().train(False), bundled(name, stand_in), STAND_IN_SIDE))
