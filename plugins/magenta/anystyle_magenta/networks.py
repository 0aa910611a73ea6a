"""Magenta's two networks, of styles and of their transfer, and the text tower."""

from collections.abc import Callable, Iterator, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle_magenta.words import WordTable

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
        blocks, channels = [], 32
        for expansion, width, count, first_stride in BLOCKS:
            for stride in (first_stride, *[1] * (count - 1)):
                blocks.append(InvertedResidual(channels, width, stride, expansion))
                channels = width
        self.blocks = nn.Sequential(*blocks)
        self.top = ConvReLU6(channels, 1280)
        self.head = nn.Linear(1280, STYLE_DIM)

    def forward(self, images: Float[Tensor, "M 3 h w"]) -> Float[Tensor, "M 100"]:
        """Style vectors, of norm 8 to 10, of sRGB images in [0, 1] with even sides, 256 by 256 in training."""
        return self.head(self.features(images).mean((2, 3)))

    def features(self, images: Float[Tensor, "M 3 h w"]) -> Float[Tensor, "M 1280 _ _"]:
        """What the linear layer reads the mean of, at a 32nd of the size."""
        return self.top(self.blocks(self.stem(images)))


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


WIDTHS, NUM_RESIDUAL = (8, 16, 32), 5
"""Channels at full, half and quarter size, a quarter of those of the paper, and blocks at quarter size."""
DIVISOR = 4
"""Sides of the images are multiples of it."""
EPSILON = 1e-5
"""Added to variances, as in the published graph."""


class StyleTransfer(nn.Module):
    """An image transformation network whose instance normalisations are set by the style.

    Ghiasi et al. 2017 (arXiv:1705.06830, section 2.1 and table 2), in the widths that Magenta publishes for phones.
    Statistics of a normalisation are taken over all views of a row: the views of a scene are stylized as one picture,
    and a picture that is a row of its own as published.
    """

    def __init__(self, *, channels: int = 3, style_dim: int = STYLE_DIM) -> None:
        super().__init__()
        full, half, quarter = WIDTHS
        down = (_reflect_conv(full, half, 3, stride=2), _reflect_conv(half, quarter, 3, stride=2))
        self.contract = nn.ModuleList([_reflect_conv(channels, full, 9), *down])
        self.residual = nn.ModuleList(Residual(quarter, style_dim) for _ in range(NUM_RESIDUAL))
        up = (StyledConv(wide, narrow, 3, style_dim, upsampling=2) for wide, narrow in ((quarter, half), (half, full)))
        self.expand = nn.ModuleList([*up, StyledConv(full, channels, 9, style_dim)])

    def forward(self, images: Float[Tensor, "B V C H W"], style: Float[Tensor, "B D"]) -> Float[Tensor, "B V C H W"]:
        """Stylize sRGB images in [0, 1], of sides of 8 or more that are multiples of 4."""
        # View by view and in place, and lists emptied as they are read: all views at full size are most of the memory.
        chunks = list(images.split(1, dim=1))
        for conv in self.contract:
            chunks = [_view_by_view(conv, x).relu_() for x in _emptied(chunks)]
        for block in self.residual:
            chunks = block(chunks, style)
        for conv in self.expand[:-1]:
            chunks = [x.relu_() for x in conv(chunks, style)]
        return torch.cat([x.sigmoid_() for x in self.expand[-1](chunks, style)], dim=1)


class Residual(nn.Module):
    """Two convolutions around an identity."""

    def __init__(self, channels: int, style_dim: int) -> None:
        super().__init__()
        self.first = StyledConv(channels, channels, 3, style_dim)
        self.second = StyledConv(channels, channels, 3, style_dim)

    def forward(self, chunks: Sequence[Tensor], style: Float[Tensor, "B D"]) -> list[Tensor]:
        hidden = [x.relu_() for x in self.first(list(chunks), style)]
        return [x + y for x, y in zip(chunks, self.second(hidden, style), strict=True)]


class StyledConv(nn.Module):
    """A convolution and a conditional instance normalisation (Dumoulin et al. 2017, arXiv:1610.07629, Eq. 5).

    The convolution has no bias, which the normalisation would remove.
    """

    def __init__(self, inputs: int, outputs: int, kernel: int, style_dim: int, *, upsampling: int = 1) -> None:
        super().__init__()
        self.upsample = nn.Upsample(scale_factor=upsampling) if upsampling > 1 else nn.Identity()
        self.conv = _reflect_conv(inputs, outputs, kernel, bias=False)
        self.scale = nn.Linear(style_dim, outputs)
        self.shift = nn.Linear(style_dim, outputs)

    def forward(self, chunks: list[Tensor], style: Float[Tensor, "B D"]) -> list[Tensor]:
        """Upsample, convolve and normalise maps ``B v C h w`` of some views at a time; the list is emptied."""
        maps = [_view_by_view(lambda x: self.conv(self.upsample(x)), x) for x in _emptied(chunks)]
        return conditional_instance_norm(maps, self.scale(style), self.shift(style))


def conditional_instance_norm(
    chunks: list[Tensor], scale: Float[Tensor, "B C"], shift: Float[Tensor, "B C"]
) -> list[Tensor]:
    """Normalise maps ``B v C h w`` by mean and variance over pixels and views of all chunks; the list is emptied."""
    num_views = sum(x.shape[1] for x in chunks)
    moments = [(x.shape[1] / num_views, *torch.var_mean(x.float(), (1, 3, 4), correction=0)) for x in chunks]
    mean = torch.stack([fraction * within for fraction, _, within in moments]).sum(0)  # B C
    variances = [fraction * (spread + (within - mean).square()) for fraction, spread, within in moments]
    variance = torch.stack(variances).sum(0)
    gain = scale * (variance + EPSILON).rsqrt()
    offset = shift - mean * gain
    gain, offset = (value[:, None, :, None, None].to(chunks[0].dtype) for value in (gain, offset))
    return [torch.addcmul(offset, x, gain) for x in _emptied(chunks)]


def _emptied(chunks: list[Tensor]) -> Iterator[Tensor]:
    """The maps of a list, which lets go of each."""
    while chunks:
        yield chunks.pop(0)


def _reflect_conv(inputs: int, outputs: int, kernel: int, *, stride: int = 1, bias: bool = True) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, padding_mode="reflect", bias=bias)


def _view_by_view(layer: Callable[[Tensor], Tensor], x: Float[Tensor, "B v C h w"]) -> Float[Tensor, "B v D _ _"]:
    return layer(x.flatten(0, 1)).unflatten(0, x.shape[:2])


class TextTower(nn.Module):
    """From the words of a text to a style vector.

    Hashed words and their letter triples are pooled to the mean and the maximum of their vectors, and a small network
    turns these into coordinates on the principal axes of style vectors.
    """

    mean: Tensor
    axes: Tensor

    def __init__(self, *, width: int = 128, hidden: int = 512, buckets: int = 4096, max_words: int = 64) -> None:
        super().__init__()
        self.max_words = max_words
        self.table = WordTable(buckets, width)
        self.head = nn.Sequential(nn.Linear(2 * width, hidden), nn.GELU(), nn.Linear(hidden, STYLE_DIM))
        self.register_buffer("mean", torch.zeros(STYLE_DIM))
        self.register_buffer("axes", torch.eye(STYLE_DIM))

    def forward(self, texts: Sequence[str]) -> Float[Tensor, "M 100"]:
        """Style vectors of texts."""
        words, present = self.table.read(texts, self.max_words)
        count = present.sum(1, keepdim=True)
        mean = (words * present[..., None]).sum(1) / count.sqrt()
        highest = words.masked_fill(~present[..., None], -torch.inf).amax(1)
        return self.mean + self.head(torch.cat([mean, highest], dim=-1)) @ self.axes
