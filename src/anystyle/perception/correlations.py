"""RAFT's correlation volume: inner products of every two features, and windows that are looked up in it."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

LEVELS, RADIUS = 4, 4
WINDOW = 2 * RADIUS + 1

Pyramid = list[Float[Tensor, "Mhw 1 _ _"]]
"""Correlations of each feature of the source with those of the target, at four sizes of the target."""


def correlation_pyramid(source: Float[Tensor, "M C h w"], target: Float[Tensor, "M C h w"]) -> Pyramid:
    """Inner products of features, divided by the root of their channels."""
    batch, channels, height, width = source.shape
    # The source is divided, not the volume, which is the largest tensor of all.
    volume = (source / channels**0.5).flatten(2).mT @ target.flatten(2)  # M hw hw
    pyramid = [volume.view(batch * height * width, 1, height, width)]
    for _ in range(LEVELS - 1):
        pyramid.append(F.avg_pool2d(pyramid[-1], 2))
    return pyramid


def look_up(pyramid: Pyramid, coords: Float[Tensor, "M 2 h w"]) -> Float[Tensor, "M 324 h w"]:
    """Correlations in a window around each target pixel, bilinear, at every size; zero outside.

    Args:
        pyramid: Of :func:`correlation_pyramid`.
        coords: For each source pixel (x, y) of its window's centre in the target, in pixels of the finest level.

    Returns:
        ``LEVELS * WINDOW**2`` channels; a window's first axis is x and its second y, as in the published network.
    """
    batch, _, height, width = coords.shape
    steps = torch.arange(-RADIUS, RADIUS + 1, dtype=coords.dtype, device=coords.device)
    window = torch.stack(torch.meshgrid(steps, steps, indexing="ij"), dim=-1)  # 9 9 2, (x, y)
    centres = coords.permute(0, 2, 3, 1).reshape(-1, 1, 1, 2)
    windows = []
    for index, level in enumerate(pyramid):
        # `grid_sample` reads [-1, 1] from the first to the last pixel.
        scale = 2 / level.new_tensor([level.shape[-1] - 1, level.shape[-2] - 1])
        grid = centres * (scale / 2**index) + (window * scale - 1)
        sampled = F.grid_sample(level, grid, mode="bilinear", padding_mode="zeros", align_corners=True)
        windows.append(sampled.reshape(batch, height, width, -1))
    return torch.cat(windows, dim=-1).permute(0, 3, 1, 2)
