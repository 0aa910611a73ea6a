"""EfficientNet-Lite0 (Tan and Le 2019, arXiv:1905.11946; "Lite": no squeeze-and-excitation, ReLU6)."""

from collections.abc import Sequence
from pathlib import Path

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.perception import weights
from anystyle.perception.features import RGB, FeatureNetwork, load_frozen

STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
"""Blocks, kernel, first stride, expansion and channels of each stage."""
MEAN, SCALE = 127 / 255, 128 / 255
"""Inputs are ``(image - MEAN) / SCALE``."""


class EfficientNetLite0(FeatureNetwork):
    """The network that was trained on ImageNet, under the keys of the package ``efficientnet_pytorch``.

    Layers are named ``expand{block}``, the expanded activations of blocks 1 to 15: the widest of each block.
    """

    def __init__(self) -> None:
        super().__init__()
        self._conv_stem = SameConv(3, 32, 3, stride=2)
        self._bn0 = _norm(32)
        blocks: list[Block] = []
        channels = 32
        for count, kernel, first_stride, expansion, width in STAGES:
            for index in range(count):
                blocks.append(Block(channels, width, kernel, first_stride if index == 0 else 1, expansion))
                channels = width
        self._blocks = nn.ModuleList(blocks)
        self._conv_head = SameConv(channels, 1280, 1)
        self._bn1 = _norm(1280)
        self._fc = nn.Linear(1280, 1000)
        self.layers = (RGB, *(f"expand{index}" for index in range(1, len(blocks))))

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        unknown = [layer for layer in layers if layer not in self.layers]
        if unknown or not layers:
            raise ValueError(f"layers are {list(layers)}; choose from {', '.join(self.layers)}")
        features = {RGB: images}
        x = self._stem(images)
        for index, block in enumerate(self._blocks[: 1 + max(map(self.layers.index, layers))]):
            assert isinstance(block, Block)
            features[f"expand{index}"] = expanded = block.expand(x)
            x = block.project(x, expanded)
        return [features[layer] for layer in layers]

    def logits(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 1000"]:
        """Scores of ImageNet's classes for sRGB images in [0, 1]; trained at 224 pixels a side."""
        x = self._stem(images)
        for block in self._blocks:
            assert isinstance(block, Block)
            x = block.project(x, block.expand(x))
        return self._fc(F.relu6(self._bn1(self._conv_head(x))).mean((2, 3)))

    def _stem(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 32 _ _"]:
        return F.relu6(self._bn0(self._conv_stem((images - MEAN) / SCALE)))


class Block(nn.Module):
    """An inverted residual block (Sandler et al. 2018, section 3.4) in two steps, for its middle is a layer."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        width = inputs * expansion
        if expansion > 1:
            self._expand_conv = SameConv(inputs, width, 1)
            self._bn0 = _norm(width)
        self.expands = expansion > 1
        self._depthwise_conv = SameConv(width, width, kernel, stride=stride, groups=width)
        self._bn1 = _norm(width)
        self._project_conv = SameConv(width, outputs, 1)
        self._bn2 = _norm(outputs)
        self.residual = stride == 1 and inputs == outputs

    def expand(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M D h w"]:
        """The wide activations."""
        return F.relu6(self._bn0(self._expand_conv(x))) if self.expands else x

    def project(self, x: Float[Tensor, "M C h w"], expanded: Float[Tensor, "M D h w"]) -> Float[Tensor, "M E _ _"]:
        """The block's output from its input and its wide activations."""
        y = self._bn2(self._project_conv(F.relu6(self._bn1(self._depthwise_conv(expanded)))))
        return x + y if self.residual else y


class SameConv(nn.Module):
    """A convolution without bias, padded as TensorFlow's SAME: ``ceil(size / stride)`` outputs, an odd pixel last."""

    def __init__(self, inputs: int, outputs: int, kernel: int, *, stride: int = 1, groups: int = 1) -> None:
        super().__init__()
        self.stride, self.groups = stride, groups
        self.weight = nn.Parameter(nn.Conv2d(inputs, outputs, kernel, groups=groups).weight.detach())

    def forward(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M D _ _"]:
        kernel = self.weight.shape[-1]
        missing = [max((-(-size // self.stride) - 1) * self.stride + kernel - size, 0) for size in x.shape[-2:]]
        padding = [side for total in reversed(missing) for side in (total // 2, total - total // 2)]
        return F.conv2d(F.pad(x, padding), self.weight, None, self.stride, 0, 1, self.groups)


def load(path: str | Path | None = None) -> EfficientNetLite0:
    """The network with its published weights.

    Raises:
        ValueError: The file is not the published one.
        FileNotFoundError: It is missing.
    """
    file = weights.find("efficientnet_lite0", path)
    if not weights.verified("efficientnet_lite0", file):
        raise ValueError(f"{file} is not the published file, by its SHA-256; install the package anew")
    return load_frozen(EfficientNetLite0(), weights.read(file), file)


def _norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, eps=1e-3)
