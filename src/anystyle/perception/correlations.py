"""What RAFT matches places by: correlations of all pairs of places, and windows of them that are looked up."""

from typing import no_type_check

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.compiled import compiled
from anystyle.perception.threads import workers
from anystyle.perception.winograd import suits

LEVELS, RADIUS = 4, 4
WINDOW = 2 * RADIUS + 1

Pyramid = list[Float[Tensor, "Mhw 1 _ _"]]
"""Correlations of each place of the source with those of the target, at four sizes of the target."""


def correlations(source: Float[Tensor, "M C h w"], target: Float[Tensor, "M C h w"]) -> Pyramid:
    """Inner products of features, divided by the root of their number."""
    count, channels, height, width = source.shape
    # The source is divided, not the volume, which is the largest tensor of all.
    volume = (source / channels**0.5).flatten(2).mT @ target.flatten(2)  # M hw hw
    level = volume.view(count * height * width, 1, height, width)
    pyramid = [level]
    for _ in range(LEVELS - 1):
        level = F.avg_pool2d(level, 2)
        pyramid.append(level)
    return pyramid


def look_up(pyramid: Pyramid, place: Float[Tensor, "M 2 h w"]) -> Float[Tensor, "M 324 h w"]:
    """Correlations in a window around each place, at every size; zero outside.

    The window's first index moves along x and its second along y, as in the published network.
    """
    return _interpolate(pyramid, place) if suits(place, *pyramid) else sample(pyramid, place)


def sample(pyramid: Pyramid, place: Float[Tensor, "M 2 h w"]) -> Float[Tensor, "M 324 h w"]:
    """:func:`look_up` as published: each of a window's places is sampled by itself."""
    count, _, height, width = place.shape
    steps = torch.arange(-RADIUS, RADIUS + 1, dtype=place.dtype, device=place.device)
    window = torch.stack(torch.meshgrid(steps, steps, indexing="ij"), dim=-1)  # 9 9 2, (x, y)
    centres = place.permute(0, 2, 3, 1).reshape(-1, 1, 1, 2)
    found = []
    for number, level in enumerate(pyramid):
        sides = level.new_tensor([level.shape[-1] - 1, level.shape[-2] - 1])
        grid = 2 * (centres / 2**number + window) / sides - 1
        sampled = F.grid_sample(level, grid, mode="bilinear", padding_mode="zeros", align_corners=True)
        found.append(sampled.reshape(count, height, width, -1))
    return torch.cat(found, dim=-1).permute(0, 3, 1, 2)


def _interpolate(pyramid: Pyramid, place: Float[Tensor, "M 2 h w"]) -> Float[Tensor, "M 324 h w"]:
    """The places of a window lie whole pixels apart: they share four weights, and neighbours their pixels."""
    count, _, height, width = place.shape
    centres = place.permute(0, 2, 3, 1).reshape(-1, 2).numpy()
    found = place.new_empty(count, height, width, LEVELS * WINDOW**2)
    rows = found.view(-1, LEVELS, WINDOW, WINDOW).numpy()
    levels = [level[:, 0].numpy() for level in pyramid]

    def work(first: int, last: int) -> None:
        some = slice(first, last)
        for number, level in enumerate(levels):
            _windows(level[some], centres[some], np.float32(0.5**number), rows[some, number])

    with workers() as share:
        share(len(rows), work)
    return found.permute(0, 3, 1, 2)


@compiled
@no_type_check
def _windows(images: np.ndarray, centres: np.ndarray, scale: float, found: np.ndarray) -> None:
    """The window of each image around its centre, interpolated along x, then along y."""
    count, height, width = images.shape
    along = np.empty((WINDOW + 1, WINDOW), np.float32)
    for n in range(count):
        x, y = centres[n, 0] * scale, centres[n, 1] * scale
        # Nothing is found far outside, nor where a place is not a number.
        if not (-WINDOW < x < width + WINDOW and -WINDOW < y < height + WINDOW):
            found[n] = 0
            continue
        left, top = int(np.floor(x)), int(np.floor(y))
        right, below = x - np.float32(left), y - np.float32(top)
        for j in range(WINDOW + 1):
            row = top - RADIUS + j
            for i in range(WINDOW):
                column = left - RADIUS + i
                one, other = np.float32(0), np.float32(0)
                if 0 <= row < height:
                    if 0 <= column < width:
                        one = images[n, row, column]
                    if 0 <= column + 1 < width:
                        other = images[n, row, column + 1]
                along[j, i] = one + right * (other - one)
        for i in range(WINDOW):
            for j in range(WINDOW):
                found[n, i, j] = along[j, i] + below * (along[j + 1, i] - along[j, i])
