"""Convolutions of five pixels in a line with two fifths of the multiplications (Winograd's ``F(4, 5)``).

The companion of :mod:`anystyle.perception.winograd` for RAFT's recurrent unit, as exact as that.
"""

from typing import no_type_check

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.compiled import compiled
from anystyle.perception.threads import workers
from anystyle.perception.winograd import FEWEST, STRIP

TAPS = 5
POINTS = (0, 1, -1, 2, -2, 1 / 2, -1 / 2)
"""Where the polynomials are evaluated whose product a convolution is; infinity is one more."""
_SCALES = (1, -2 / 9, -2 / 9, 1 / 90, 1 / 90, 32 / 45, 32 / 45)


def values_of(weight: Float[Tensor, "K C 5"]) -> Float[Tensor, "8 C K"]:
    """A kernel's values at the points."""
    powers = torch.tensor([[s * p**j for j in range(TAPS)] for p, s in zip(POINTS, _SCALES, strict=True)])
    matrix = torch.cat([powers.double(), torch.eye(TAPS, dtype=torch.float64)[-1:]])
    return torch.einsum("pj,kcj->pck", matrix.to(weight.device), weight.double()).to(weight.dtype).contiguous()


def convolve(images: Float[Tensor, "M C H W"], values: Float[Tensor, "8 C K"], axis: int) -> Float[Tensor, "M K H W"]:
    """Convolve rows (``axis`` 3) or columns (2) with a border of zeros; in channels-last memory.

    Args:
        images: In float32, on the CPU.
        values: Of :func:`values_of`.
        axis: Along which.
    """
    count, channels, height, width = images.shape
    width_out = values.shape[2]
    pixels = images.permute(0, 2, 3, 1).contiguous()
    found = pixels.new_empty(count, height, width, width_out)
    # How many lines, how long, and the steps in memory from line to line and from pixel to pixel.
    shape = (height, width, width, 1) if axis == 3 else (width, height, 1, width)
    tiles = -(-shape[1] // 4)
    most = max(1, max(FEWEST, STRIP // (4 * 8 * (channels + width_out))) // tiles)
    lines = -(-shape[0] // -(-shape[0] // most))
    read = pixels.new_empty(8, lines * tiles, channels)
    made = pixels.new_empty(8, lines * tiles, width_out)
    with workers() as share:
        for image, result in zip(pixels.flatten(1, 2).numpy(), found.flatten(1, 2).numpy(), strict=True):
            for first in range(0, shape[0], lines):
                some = min(lines, shape[0] - first)
                share(some, lambda a, b, i=image, f=first: _read(i, read.numpy(), f, a, b, *shape[1:]))
                used = some * tiles
                torch.bmm(read[:, :used], values, out=made[:, :used])
                share(some, lambda a, b, r=result, f=first: _write(made.numpy(), r, f, a, b, *shape[1:]))
    return found.permute(0, 3, 1, 2)


@compiled
@no_type_check
def _read(
    image: np.ndarray, values: np.ndarray, origin: int, first: int, last: int, length: int, across: int, along: int
) -> None:
    """Values at the points of the tiles of some lines, from eight pixels each."""
    channels = image.shape[1]
    tiles = (length + 3) // 4
    pixels = np.empty((8, channels), np.float32)
    a, b, c, d = np.float32(5.25), np.float32(4.25), np.float32(2.5), np.float32(1.25)
    two, four, five, half, fourth = np.float32(2), np.float32(4), np.float32(5), np.float32(0.5), np.float32(0.25)
    for line in range(first, last):
        for tile in range(tiles):
            place = line * tiles + tile
            for j in range(8):
                at = 4 * tile - 2 + j
                if 0 <= at < length:
                    pixels[j, :] = image[(origin + line) * across + at * along, :]
                else:
                    pixels[j, :] = 0
            for n in range(channels):
                p0, p1, p2, p3 = pixels[0, n], pixels[1, n], pixels[2, n], pixels[3, n]
                p4, p5, p6, p7 = pixels[4, n], pixels[5, n], pixels[6, n], pixels[7, n]
                values[0, place, n] = p0 - p6 + a * (p4 - p2)
                even, odd = p2 + p6 - b * p4, p1 + p5 - b * p3
                values[1, place, n] = even + odd
                values[2, place, n] = even - odd
                even, odd = fourth * p2 - d * p4 + p6, half * p1 - c * p3 + two * p5
                values[3, place, n] = even + odd
                values[4, place, n] = even - odd
                even, odd = four * p2 - five * p4 + p6, two * p1 - c * p3 + half * p5
                values[5, place, n] = even + odd
                values[6, place, n] = even - odd
                values[7, place, n] = p7 - p1 + a * (p3 - p5)


@compiled
@no_type_check
def _write(
    values: np.ndarray, image: np.ndarray, origin: int, first: int, last: int, length: int, across: int, along: int
) -> None:
    """Four pixels of each tile of some lines from their values at the points."""
    channels = image.shape[1]
    tiles = (length + 3) // 4
    pixels = np.empty((4, channels), np.float32)
    two, four, eight = np.float32(2), np.float32(4), np.float32(8)
    half, fourth, eighth = np.float32(0.5), np.float32(0.25), np.float32(0.125)
    for line in range(first, last):
        for tile in range(tiles):
            place = line * tiles + tile
            for n in range(channels):
                p, m = values[1, place, n], values[2, place, n]
                near, skew = p + m, p - m
                p, m = values[3, place, n], values[4, place, n]
                far, wide = p + m, p - m
                p, m = values[5, place, n], values[6, place, n]
                inner, close = p + m, p - m
                pixels[0, n] = values[0, place, n] + near + far + inner
                pixels[1, n] = skew + two * wide + half * close
                pixels[2, n] = near + four * far + fourth * inner
                pixels[3, n] = skew + eight * wide + eighth * close + values[7, place, n]
            for j in range(min(4, length - 4 * tile)):
                image[(origin + line) * across + (4 * tile + j) * along, :] = pixels[j, :]
