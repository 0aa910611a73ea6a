"""ArtScore: a ResNet-50 trained to rank images by how much they look like fine art (Chen et al. 2024)."""

from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.vision import weights
from anystyle.vision.features import Frozen, load_frozen
from anystyle.vision.vgg import MEAN, STD

STAGES = ((64, 3, 1), (128, 4, 2), (256, 6, 2), (512, 3, 2))
"""Width, blocks and stride of each stage."""


class ArtScoreNet(Frozen):
    """ResNet-50 (He et al. 2016) with a head of two layers, under torchvision's keys and ``fc.0``, ``fc.3``."""

    mean: Tensor
    std: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        channels = 64
        for index, (width, num_blocks, stride) in enumerate(STAGES, start=1):
            rest = (Bottleneck(4 * width, width, 1) for _ in range(num_blocks - 1))
            self.add_module(f"layer{index}", nn.Sequential(Bottleneck(channels, width, stride), *rest))
            channels = 4 * width
        # The identity keeps the index of a dropout, which has no weights.
        self.fc = nn.Sequential(nn.Linear(channels, 1000), nn.ReLU(), nn.Identity(), nn.Linear(1000, 1))
        self.register_buffer("mean", torch.tensor(MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(STD).view(3, 1, 1), persistent=False)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        """Unbounded scores of sRGB images in [0, 1]; higher is more like art."""
        x = F.relu(self.bn1(self.conv1((images - self.mean) / self.std)))
        x = F.max_pool2d(x, 3, stride=2, padding=1)
        for index in range(1, 5):
            x = self.get_submodule(f"layer{index}")(x)
        return self.fc(x.mean((2, 3))).squeeze(-1)


def load(path: str | Path | None = None) -> ArtScoreNet:
    """The network with the published weights."""
    file = weights.find("art_score", path)
    return load_frozen(ArtScoreNet(), weights.read(file), file)


class Bottleneck(nn.Module):
    """1x1, 3x3, 1x1, added to its input; the stride is on the 3x3."""

    def __init__(self, channels: int, width: int, stride: int) -> None:
        super().__init__()
        out = 4 * width
        self.conv1 = nn.Conv2d(channels, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride=stride, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, out, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(out)
        self.downsample = nn.Sequential()
        if channels != out:
            self.downsample.append(nn.Conv2d(channels, out, 1, stride=stride, bias=False)).append(nn.BatchNorm2d(out))

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.bn1(self.conv1(x)), inplace=True)
        y = self.bn3(self.conv3(F.relu(self.bn2(self.conv2(y)), inplace=True)))
        return F.relu(y + self.downsample(x), inplace=True)
