"""EfficientNet-Lite0 (Tan and Le 2019, arXiv:1905.11946; "Lite": no squeeze-and-excitation, ReLU6)."""

from collections.abc import Iterator, Sequence

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.vision.features import RGB, FeatureNetwork, known_layers

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
    """Trained on ImageNet, under the keys of the package ``efficientnet_pytorch``.

    Layers are named ``expand{block}``, the expanded activations of blocks 1 to 15: the widest of each block.
    """

    def __init__(self) -> None:
        super().__init__()
        self._conv_stem = SameConv(3, 32, 3, stride=2)
        self._bn0 = nn.BatchNorm2d(32, eps=1e-3)
        blocks: list[MBConv] = []
        channels = 32
        for count, kernel, first_stride, expansion, width in STAGES:
            for index in range(count):
                blocks.append(MBConv(channels, width, kernel, first_stride if index == 0 else 1, expansion))
                channels = width
        self._blocks = nn.ModuleList(blocks)
        self._conv_head = SameConv(channels, 1280, 1)
        self._bn1 = nn.BatchNorm2d(1280, eps=1e-3)
        self._fc = nn.Linear(1280, 1000)
        self.layers = (RGB, *(f"expand{index}" for index in range(1, len(blocks))))

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        features, deepest = {RGB: images}, max(map(self.layers.index, known_layers(layers, self.layers)))
        for index, (wide, _) in zip(range(1 + deepest), self._run(images), strict=False):
            features[f"expand{index}"] = wide
        return [features[layer] for layer in layers]

    def logits(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 1000"]:
        """Scores of ImageNet's classes for sRGB images in [0, 1]; trained at 224 x 224 pixels."""
        last = [output for _, output in self._run(images)][-1]
        return self._fc(F.relu6(self._bn1(self._conv_head(last))).mean((2, 3)))

    def _run(self, images: Float[Tensor, "M 3 H W"]) -> Iterator[tuple[Tensor, Tensor]]:
        """The wide activations and the output of each block."""
        x = F.relu6(self._bn0(self._conv_stem((images - MEAN) / SCALE)))
        for block in self._blocks:
            assert isinstance(block, MBConv)
            wide = block.expand(x)
            x = block.project(x, wide)
            yield wide, x


class MBConv(nn.Module):
    """An inverted residual block (Sandler et al. 2018, section 3.4) in two steps, because its middle is a layer."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        width = inputs * expansion
        if expansion > 1:
            self._expand_conv = SameConv(inputs, width, 1)
            self._bn0 = nn.BatchNorm2d(width, eps=1e-3)
        self.expands = expansion > 1
        self._depthwise_conv = SameConv(width, width, kernel, stride=stride, groups=width)
        self._bn1 = nn.BatchNorm2d(width, eps=1e-3)
        self._project_conv = SameConv(width, outputs, 1)
        self._bn2 = nn.BatchNorm2d(outputs, eps=1e-3)
        self.residual = stride == 1 and inputs == outputs

    def expand(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M D h w"]:
        return F.relu6(self._bn0(self._expand_conv(x))) if self.expands else x

    def project(self, x: Float[Tensor, "M C h w"], expanded: Float[Tensor, "M D h w"]) -> Float[Tensor, "M E _ _"]:
        y = self._bn2(self._project_conv(F.relu6(self._bn1(self._depthwise_conv(expanded)))))
        return x + y if self.residual else y


class SameConv(nn.Conv2d):
    """A convolution without bias, padded as TensorFlow's SAME: ``ceil(size / stride)`` outputs, an odd pixel last."""

    def __init__(self, inputs: int, outputs: int, kernel: int, *, stride: int = 1, groups: int = 1) -> None:
        super().__init__(inputs, outputs, kernel, stride, groups=groups, bias=False)

    def forward(self, input: Float[Tensor, "M C h w"]) -> Float[Tensor, "M D _ _"]:
        kernel, stride = self.kernel_size[0], self.stride[0]
        missing = [max((-(-size // stride) - 1) * stride + kernel - size, 0) for size in input.shape[-2:]]
        return super().forward(
            F.pad(input, [side for total in reversed(missing) for side in (total // 2, -(-total // 2))])
        )
