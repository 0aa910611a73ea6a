"""ArtScore: a ResNet-50 trained to rank images by how much they look like fine art (Chen et al. 2024)."""

from pathlib import Path

from jaxtyping import Float
from kornia.feature.defmo import Bottleneck, ResNet
from torch import Tensor, nn

from anystyle.vision import weights
from anystyle.vision.features import Frozen, load_frozen
from anystyle.vision.preprocess import normalised
from anystyle.vision.vgg import MEAN, STD


class ArtScoreNet(Frozen, ResNet):
    """ResNet-50 (He et al. 2016) with a head of two layers, under torchvision's keys and ``fc.0``, ``fc.3``."""

    def __init__(self) -> None:
        ResNet.__init__(self, Bottleneck, [3, 4, 6, 3])
        # The identity keeps the index of a dropout, which has no weights.
        self.fc = nn.Sequential(nn.Linear(2048, 1000), nn.ReLU(), nn.Identity(), nn.Linear(1000, 1))

    def forward(self, x: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        """Unbounded scores of sRGB images in [0, 1]; higher is more like art."""
        return super().forward(normalised(x, MEAN, STD)).squeeze(-1)


def load(path: str | Path | None = None) -> ArtScoreNet:
    """The network with the published weights."""
    file = weights.find("art_score", path)
    return load_frozen(ArtScoreNet(), weights.read(file), file)
