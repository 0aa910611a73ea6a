"""Networks that map a whole image to a vector, for FID and KID, or to a score; with stand-ins."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import perception
from anystyle.perception import art_score, inception
from anystyle.perception.features import FeatureNetwork, Frozen, freeze
from anystyle.perception.lpips import STAND_IN_LAYERS, STAND_IN_SIDE
from anystyle.perception.preprocess import shrunk
from anystyle.perception.sources import Source, Weights, bundled, locate, published
from anystyle.perception.statistics import pooled_moments


class SourcedNetwork(Frozen):
    """A network with the source of its weights.

    Args:
        network: From sRGB images ``M 3 H W`` in [0, 1] to ``M D`` or ``M`` numbers.
        source: Of its weights.
        longest: Images are shrunk to this longest side in pixels; ``None`` leaves them as they are.
    """

    def __init__(self, network: nn.Module, source: Source, longest: int | None = None) -> None:
        super().__init__()
        self.network = network
        self.source = source
        self.longest = longest

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M *D"]:
        return self.network(shrunk(images, self.longest))


class TextureMoments(Frozen):
    """Mean and deviation of every channel of the bundled texture network: 640 numbers."""

    def __init__(self, network: FeatureNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 640"]:
        """The moments of the last map of every block."""
        return torch.cat([pooled_moments(features) for features in self.network(images, STAND_IN_LAYERS)], dim=1)


class TextureScore(Frozen):
    """The product of :class:`TextureMoments` with a fixed random direction: a number that does not measure art."""

    direction: Tensor

    def __init__(self, network: FeatureNetwork) -> None:
        super().__init__()
        self.moments = TextureMoments(network)
        drawn = torch.randn(640, generator=torch.Generator().manual_seed(0))
        self.register_buffer("direction", F.normalize(drawn, dim=0), persistent=False)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        """The moments projected on the direction."""
        return self.moments(images) @ self.direction


def load_art_inception(choice: Weights = "auto") -> SourcedNetwork:
    """The network of ArtFID, or its stand-in.

    Raises:
        FileNotFoundError: The weights are missing and no stand-in is allowed.
        ValueError: The file does not hold them.
    """
    file = locate("art_inception", choice)
    if file is None:
        moments = TextureMoments(perception.load("texture"))
        return freeze(SourcedNetwork(moments.train(False), bundled("art_inception", "texture_moments"), STAND_IN_SIDE))
    return SourcedNetwork(inception.load(file), published("art_inception", file))


def load_art_score(choice: Weights = "auto") -> SourcedNetwork:
    """The network of ArtScore, or its stand-in.

    Raises:
        FileNotFoundError: The weights are missing and no stand-in is allowed.
        ValueError: The file does not hold them.
    """
    file = locate("art_score", choice)
    if file is None:
        score = TextureScore(perception.load("texture"))
        return freeze(SourcedNetwork(score.train(False), bundled("art_score", "texture_score"), STAND_IN_SIDE))
    return SourcedNetwork(art_score.load(file), published("art_score", file))
