"""Networks that map a whole image to a vector, for FID and KID, or to a score; with stand-ins."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.types import Source
from anystyle.vision import art_score, inception, networks
from anystyle.vision.features import Frozen, freeze
from anystyle.vision.lpips import STAND_IN_LAYERS, STAND_IN_SIDE
from anystyle.vision.preprocess import shrunk
from anystyle.vision.statistics import pooled_moments
from anystyle.vision.weights import Weights, bundled, locate, published


class SourcedNetwork(Frozen):
    """A network from images in [0, 1], shrunk to a longest side, to a vector or a score, with its weights' source."""

    def __init__(self, network: nn.Module, source: Source, longest: int | None = None) -> None:
        super().__init__()
        self.network, self.source, self.longest = network, source, longest

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M *D"]:
        return self.network(shrunk(images, self.longest))


class TextureMoments(Frozen):
    """Mean and deviation of every channel of the bundled texture network: 640 numbers."""

    def __init__(self) -> None:
        super().__init__()
        self.network = networks.load("texture")

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 640"]:
        return torch.cat([pooled_moments(features) for features in self.network(images, STAND_IN_LAYERS)], dim=1)


class TextureScore(TextureMoments):
    """The product of :class:`TextureMoments` with a fixed random direction: a number that does not measure art."""

    direction: Tensor

    def __init__(self) -> None:
        super().__init__()
        drawn = torch.randn(640, generator=torch.Generator().manual_seed(0))
        self.register_buffer("direction", F.normalize(drawn, dim=0), persistent=False)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        return super().forward(images) @ self.direction


def load_art_inception(choice: Weights = "auto") -> SourcedNetwork:
    """The network of ArtFID, or its stand-in."""
    file = locate("art_inception", choice)
    if file is None:
        return _stand_in(TextureMoments(), bundled("art_inception", "texture_moments"))
    return SourcedNetwork(inception.load(file), published("art_inception", file))


def load_art_score(choice: Weights = "auto") -> SourcedNetwork:
    """The network of ArtScore, or its stand-in."""
    file = locate("art_score", choice)
    if file is None:
        return _stand_in(TextureScore(), bundled("art_score", "texture_score"))
    return SourcedNetwork(art_score.load(file), published("art_score", file))


def _stand_in(network: TextureMoments, source: Source) -> SourcedNetwork:
    return freeze(SourcedNetwork(network.train(False), source, STAND_IN_SIDE))
