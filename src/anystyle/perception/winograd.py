"""3x3 convolutions with a quarter of the multiplications (Winograd; Lavin and Gray, CVPR 2016, ``F(4x4, 3x3)``).

Exact but for rounding, which is about four times that of the direct sum: a few parts in a million of the largest value.
For networks that judge many images on a processor and are never asked for gradients.
"""

from typing import TypeVar, no_type_check

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.compiled import compiled
from anystyle.perception.threads import workers

TILE = 4
"""Pixels a side of what is computed together; it reads two more."""

STRIP = 1 << 21
"""Bytes of transformed values that are held at once: they should stay in a core's caches."""

FEWEST = 196
"""Tiles that are computed together at least, or else the weights are read more often than pixels."""

NARROWEST = 48
"""Channels below which the transforms cost more than they save."""

_KERNEL = (
    (1 / 4, 0, 0),
    (-1 / 6, -1 / 6, -1 / 6),
    (-1 / 6, 1 / 6, -1 / 6),
    (1 / 24, 1 / 12, 1 / 6),
    (1 / 24, -1 / 12, 1 / 6),
    (0, 0, 1),
)
"""From three weights to the values at the points 0, 1, -1, 2, -2 and infinity of the polynomial that they are."""

Network = TypeVar("Network", bound=nn.Module)


def quicken(network: Network) -> Network:
    """Let a network compute those of its convolutions in this way that gain by it; keys and weights stay the same.

    Args:
        network: Frozen. Convolutions of 3x3, stride 1 and a border of 1 are exchanged.
    """
    for module in list(network.modules()):
        for name, child in list(module.named_children()):
            if type(child) is nn.Conv2d and _gains(child):
                setattr(module, name, Conv3x3(child))
    # What the others make lies in memory as these read it.
    return network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]


def _gains(conv: nn.Conv2d) -> bool:
    shape = (conv.kernel_size, conv.stride, conv.padding, conv.dilation, conv.groups, conv.padding_mode)
    usual = shape == ((3, 3), (1, 1), (1, 1), (1, 1), 1, "zeros")
    return usual and conv.bias is not None and min(conv.in_channels, conv.out_channels) >= NARROWEST


def suits(*tensors: Tensor) -> bool:
    """Whether a computation of these may be compiled: on the CPU, in float32 and without gradients."""
    return not torch.is_grad_enabled() and all(x.device.type == "cpu" and x.dtype == torch.float32 for x in tensors)


class Conv3x3(nn.Conv2d):
    """A convolution of 3x3 with a border of zeros.

    Where gradients are wanted, off the CPU and in other precisions than float32 it is the usual one.

    Args:
        conv: Whose weights it takes.
    """

    def __init__(self, conv: nn.Conv2d) -> None:
        super().__init__(conv.in_channels, conv.out_channels, 3, padding=1, device="meta")
        self.weight, self.bias = conv.weight, conv.bias
        self.direct = False
        self._values: tuple[tuple[int, int], Tensor] | None = None

    def forward(self, input: Float[Tensor, "M C H W"]) -> Float[Tensor, "M K H W"]:
        """The convolution; in channels-last memory where it is computed in tiles."""
        if self.direct or not suits(input, self.weight):
            return super().forward(input)
        return self._in_tiles(input.permute(0, 2, 3, 1).contiguous())

    def values(self) -> Float[Tensor, "36 C K"]:
        """The weights at the 6 x 6 points, computed once."""
        state = (self.weight.data_ptr(), 0 if self.weight.is_inference() else self.weight._version)
        if self._values is None or self._values[0] != state:
            kernel = torch.tensor(_KERNEL, dtype=torch.float64)
            values = torch.einsum("ij,kcjl,ml->imck", kernel, self.weight.detach().double(), kernel)
            self._values = state, values.flatten(0, 1).float().contiguous()
        return self._values[1]

    def _in_tiles(self, x: Float[Tensor, "M H W C"]) -> Float[Tensor, "M K H W"]:
        count, height, width, channels = x.shape
        rows, columns = -(-height // TILE), -(-width // TILE)
        threads = torch.get_num_threads()
        tiles = threads * max(FEWEST, STRIP // (4 * 36 * (channels + self.out_channels)))
        together = min(rows, -(-tiles // columns))
        values = self.values()
        bias = self.get_parameter("bias").detach().numpy()
        found = x.new_empty(count, height, width, self.out_channels)
        # One tile more than is used: the points' values must not lie powers of two apart, where caches have one place.
        read = x.new_empty(36, together * columns + 1, channels)
        made = x.new_empty(36, together * columns + 1, self.out_channels)
        with workers() as share:
            for image, result in zip(x.numpy(), found.numpy(), strict=True):
                for first in range(0, rows, together):
                    some = min(together, rows - first)
                    used = some * columns
                    share(some, lambda a, b, i=image, f=first: _read(i, read.numpy(), f, a, b))
                    torch.bmm(read[:, :used], values, out=made[:, :used])
                    share(some, lambda a, b, r=result, f=first: _write(made.numpy(), bias, r, f, a, b))
        return found.permute(0, 3, 1, 2)


@compiled
@no_type_check
def _read(image: np.ndarray, values: np.ndarray, origin: int, first: int, last: int) -> None:
    """Values at the 36 points of tiles in some rows: ``Bt d B`` of each 6 x 6 pixels ``d``."""
    height, width, channels = image.shape
    columns = (width + 3) // 4
    pixels = np.empty((6, channels), np.float32)
    half = np.empty((6, 6, channels), np.float32)
    four, five, two = np.float32(4), np.float32(5), np.float32(2)
    for row in range(first, last):
        for column in range(columns):
            place = row * columns + column
            for j in range(6):
                x = 4 * column - 1 + j
                for i in range(6):
                    y = 4 * (origin + row) - 1 + i
                    if 0 <= y < height and 0 <= x < width:
                        pixels[i, :] = image[y, x, :]
                    else:
                        pixels[i, :] = 0
                for c in range(channels):
                    p0, p1, p2 = pixels[0, c], pixels[1, c], pixels[2, c]
                    p3, p4, p5 = pixels[3, c], pixels[4, c], pixels[5, c]
                    even, odd = p4 - four * p2, p3 - four * p1
                    half[0, j, c] = four * p0 - five * p2 + p4
                    half[1, j, c] = even + odd
                    half[2, j, c] = even - odd
                    even, odd = p4 - p2, two * (p3 - p1)
                    half[3, j, c] = even + odd
                    half[4, j, c] = even - odd
                    half[5, j, c] = four * p1 - five * p3 + p5
            for i in range(6):
                for c in range(channels):
                    p0, p1, p2 = half[i, 0, c], half[i, 1, c], half[i, 2, c]
                    p3, p4, p5 = half[i, 3, c], half[i, 4, c], half[i, 5, c]
                    even, odd = p4 - four * p2, p3 - four * p1
                    values[6 * i, place, c] = four * p0 - five * p2 + p4
                    values[6 * i + 1, place, c] = even + odd
                    values[6 * i + 2, place, c] = even - odd
                    even, odd = p4 - p2, two * (p3 - p1)
                    values[6 * i + 3, place, c] = even + odd
                    values[6 * i + 4, place, c] = even - odd
                    values[6 * i + 5, place, c] = four * p1 - five * p3 + p5


@compiled
@no_type_check
def _write(values: np.ndarray, bias: np.ndarray, image: np.ndarray, origin: int, first: int, last: int) -> None:
    """Pixels of tiles in some rows from their values at the 36 points: ``At m A``, and the bias."""
    height, width, channels = image.shape
    columns = (width + 3) // 4
    half = np.empty((4, 6, channels), np.float32)
    four, eight, two = np.float32(4), np.float32(8), np.float32(2)
    for row in range(first, last):
        for column in range(columns):
            place = row * columns + column
            for j in range(6):
                for c in range(channels):
                    a, b = values[6 + j, place, c], values[12 + j, place, c]
                    d, e = values[18 + j, place, c], values[24 + j, place, c]
                    near, skew, far, wide = a + b, a - b, d + e, d - e
                    half[0, j, c] = values[j, place, c] + near + far
                    half[1, j, c] = skew + two * wide
                    half[2, j, c] = near + four * far
                    half[3, j, c] = skew + eight * wide + values[30 + j, place, c]
            for i in range(min(4, height - 4 * (origin + row))):
                y, x = 4 * (origin + row) + i, 4 * column
                for c in range(channels):
                    a, b, d, e = half[i, 1, c], half[i, 2, c], half[i, 3, c], half[i, 4, c]
                    image[y, x, c] = half[i, 0, c] + a + b + d + e + bias[c]
                if x + 1 < width:
                    for c in range(channels):
                        image[y, x + 1, c] = (
                            half[i, 1, c] - half[i, 2, c] + two * (half[i, 3, c] - half[i, 4, c]) + bias[c]
                        )
                if x + 2 < width:
                    for c in range(channels):
                        image[y, x + 2, c] = (
                            half[i, 1, c] + half[i, 2, c] + four * (half[i, 3, c] + half[i, 4, c]) + bias[c]
                        )
                if x + 3 < width:
                    for c in range(channels):
                        image[y, x + 3, c] = (
                            half[i, 1, c] - half[i, 2, c]
                            + eight * (half[i, 3, c] - half[i, 4, c]) + half[i, 5, c] + bias[c]
                        )  # fmt: skip
