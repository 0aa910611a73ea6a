"""The style prediction network: from a picture to the numbers that steer the style transfer network."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

STYLE_DIM = 100
"""Length of a style vector."""
SIDE = 256
"""Sides in pixels of the pictures that the network was trained on."""

BLOCKS = (
    (1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1),
)  # fmt: skip
"""Expansion, channels, number of blocks and first stride of each stage (Sandler et al. 2018, table 2)."""


class StylePrediction(nn.Module):
    """MobileNetV2 without its classifier, and a linear layer (Ghiasi et al. 2017, arXiv:1705.06830, section 2.2).

    The authors' network is an Inception-v3; Magenta distilled it into this one for phones. Batch normalisations are
    part of the convolutions.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stem = ConvReLU6(3, 32, kernel=3, stride=2)
        blocks: list[nn.Module] = []
        channels = 32
        for expansion, width, count, first_stride in BLOCKS:
            for index in range(count):
                blocks.append(InvertedResidual(channels, width, first_stride if index == 0 else 1, expansion))
                channels = width
        self.blocks = nn.Sequential(*blocks)
        self.top = ConvReLU6(channels, 1280)
        self.head = nn.Linear(1280, STYLE_DIM)

    def forward(self, images: Float[Tensor, "M 3 h w"]) -> Float[Tensor, "M 100"]:
        """Style vectors, of norm 8 to 10, of sRGB images in [0, 1] with even sides, 256 by 256 in training."""
        return self.head(self.top(self.blocks(self.stem(images))).mean((2, 3)))


class ConvReLU6(nn.Module):
    """A convolution padded as TensorFlow's SAME for even sizes, and a ReLU that ends at 6."""

    def __init__(self, inputs: int, outputs: int, *, kernel: int = 1, stride: int = 1, groups: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, groups=groups)
        before, after = {1: (0, 0), 3: (1, 1) if stride == 1 else (0, 1)}[kernel]
        self.padding = (before, after, before, after)

    def forward(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M D _ _"]:
        return F.relu6(self.conv(F.pad(x, self.padding)))


class InvertedResidual(nn.Module):
    """Expand, convolve channel by channel, project (Sandler et al. 2018, section 3.4)."""

    def __init__(self, inputs: int, outputs: int, stride: int, expansion: int) -> None:
        super().__init__()
        width = inputs * expansion
        self.expand = ConvReLU6(inputs, width) if expansion > 1 else nn.Identity()
        self.depthwise = ConvReLU6(width, width, kernel=3, stride=stride, groups=width)
        self.project = nn.Conv2d(width, outputs, 1)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Float[Tensor, "M C h w"]) -> Float[Tensor, "M D _ _"]:
        y = self.project(self.depthwise(self.expand(x)))
        return x + y if self.residual else y
