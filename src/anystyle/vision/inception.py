"""Inception-v3 as ArtFID trained it on paintings (Wright and Ommer, GCPR 2022)."""

from collections.abc import Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.vision import networks, weights
from anystyle.vision.features import Frozen, load_frozen

Kernel = int | tuple[int, int]
UnitChain = Sequence[tuple[str, int, Kernel]]
"""Units in a row: name, channels, kernel. Names that end in ``a`` and ``b`` are two ends of one row."""
LONG, TALL = (1, 7), (7, 1)
DOUBLE: UnitChain = (("branch3x3dbl_1", 64, 1), ("branch3x3dbl_2", 96, 3), ("branch3x3dbl_3", 96, 3))


def _factorised(width: int) -> list[UnitChain]:
    once = (("branch7x7_1", width, 1), ("branch7x7_2", width, LONG), ("branch7x7_3", 192, TALL))
    kernels = enumerate((TALL, LONG, TALL, LONG), start=2)
    twice = [(f"branch7x7dbl_{index}", 192 if index == 5 else width, kernel) for index, kernel in kernels]
    return [(("branch1x1", 192, 1),), once, [("branch7x7dbl_1", width, 1), *twice]]


def _ends(name: str) -> UnitChain:
    return ((f"{name}a", 384, (1, 3)), (f"{name}b", 384, (3, 1)))


A: list[UnitChain] = [(("branch1x1", 64, 1),), (("branch5x5_1", 48, 1), ("branch5x5_2", 64, 5)), DOUBLE]
B: list[UnitChain] = [(("branch3x3", 384, 3),), DOUBLE]
D: list[UnitChain] = [
    (("branch3x3_1", 192, 1), ("branch3x3_2", 320, 3)),
    (("branch7x7x3_1", 192, 1), ("branch7x7x3_2", 192, LONG), ("branch7x7x3_3", 192, TALL), ("branch7x7x3_4", 192, 3)),
]
E: list[UnitChain] = [
    (("branch1x1", 320, 1),),
    (("branch3x3_1", 384, 1), *_ends("branch3x3_2")),
    (("branch3x3dbl_1", 448, 1), ("branch3x3dbl_2", 384, 3), *_ends("branch3x3dbl_3")),
]
BLOCKS: list[tuple[str, int, list[UnitChain], int | None]] = [
    *(("5b", 192, A, 32), ("5c", 256, A, 64), ("5d", 288, A, 64), ("6a", 288, B, None)),
    *(("6b", 768, _factorised(128), 192), ("6c", 768, _factorised(160), 192), ("6d", 768, _factorised(160), 192)),
    *(("6e", 768, _factorised(192), 192), ("7a", 768, D, None), ("7b", 1280, E, 192), ("7c", 2048, E, 192)),
]
"""Name, channels of the input, rows and pooled channels of each block."""


class ArtInception(Frozen):
    """The features of Inception-v3 (Szegedy et al. 2016), under torchvision's keys; 2048 per image."""

    def __init__(self) -> None:
        super().__init__()
        self.Conv2d_1a_3x3 = ConvUnit(3, 32, 3, stride=2)
        self.Conv2d_2a_3x3 = ConvUnit(32, 32, 3, padding=0)
        self.Conv2d_2b_3x3 = ConvUnit(32, 64, 3)
        self.Conv2d_3b_1x1 = ConvUnit(64, 80, 1)
        self.Conv2d_4a_3x3 = ConvUnit(80, 192, 3, padding=0)
        for name, channels, chains, pooled in BLOCKS:
            self.add_module(f"Mixed_{name}", InceptionBlock(channels, chains, pooled))

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 2048"]:
        """The last block averaged over all pixels, of sRGB images in [0, 1] that are not normalised, as published."""
        if min(images.shape[-2:]) < 75:
            height, width = images.shape[-2:]
            raise UserError(f"images of {height}x{width} pixels are too small for Inception-v3; enlarge them to 75")
        x = self.Conv2d_2b_3x3(self.Conv2d_2a_3x3(self.Conv2d_1a_3x3(images)))
        x = self.Conv2d_4a_3x3(self.Conv2d_3b_1x1(F.max_pool2d(x, 3, stride=2)))
        x = F.max_pool2d(x, 3, stride=2)
        for name, *_ in BLOCKS:
            x = self.get_submodule(f"Mixed_{name}")(x)
        return x.mean((2, 3))


def load(path: str | Path | None = None) -> ArtInception:
    """The network with the published weights."""
    file, network = weights.find("art_inception", path), ArtInception()
    return load_frozen(network, networks.part_of(network, weights.read(file)), file)


class ConvUnit(nn.Module):
    """Convolution, normalisation, rectification."""

    def __init__(self, channels: int, width: int, kernel: Kernel, stride: int = 1, padding: int | str = "same") -> None:
        super().__init__()
        padding = padding if stride == 1 else 0
        self.conv = nn.Conv2d(channels, width, kernel, stride=stride, padding=padding, bias=False)
        self.bn = nn.BatchNorm2d(width, eps=0.001)

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(self.bn(self.conv(x)), inplace=True)


class InceptionBlock(nn.Module):
    """Rows of units side by side and a pooling, their outputs concatenated.

    The pooling is an average with a unit of ``pooled`` channels; ``None`` halves the size instead: each row's last unit
    has stride 2, and the pooling takes the maximum.
    """

    def __init__(self, channels: int, chains: Sequence[UnitChain], pooled: int | None) -> None:
        super().__init__()
        self.chains = [[name for name, *_ in chain] for chain in chains]
        for chain in chains:
            inputs = channels
            for name, width, kernel in chain:
                stride = 2 if pooled is None and name == chain[-1][0] else 1
                self.add_module(name, ConvUnit(inputs, width, kernel, stride))
                inputs = width
        self.branch_pool = None if pooled is None else ConvUnit(channels, pooled, 1)

    def forward(self, x: Tensor) -> Tensor:
        outputs: list[Tensor] = []
        for chain in self.chains:
            y = x
            for name in chain:
                unit = self.get_submodule(name)
                if name.endswith("a"):
                    outputs.append(unit(y))
                else:
                    y = unit(y)
            outputs.append(y)
        if self.branch_pool is None:
            return torch.cat([*outputs, F.max_pool2d(x, 3, stride=2)], dim=1)
        return torch.cat([*outputs, self.branch_pool(F.avg_pool2d(x, 3, stride=1, padding=1))], dim=1)
