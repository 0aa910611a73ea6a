"""Initial values for training without pretrained weights: a network that shows its photographs on a plane.

Depth is about 1, cameras stand at the origin, and every pixel is a Gaussian of its own colour and about its footprint's
size. What leads elsewhere starts small, so that learning departs from a picture and not from noise.
"""

import math

import torch
from torch import Tensor, nn

FIELD_OF_VIEW = math.radians(55)
OPACITY = 0.9
OPACITY_LOGIT = math.log(OPACITY / (1 - OPACITY))
PIXELS = 0.5
"""Standard deviation of a Gaussian in footprints of its pixel: at a half, neighbours just overlap."""
SMALL = 0.01
"""Standard deviation of the weights of layers that tell what departs from the plane."""


def conv(layer: nn.Module) -> tuple[Tensor, Tensor]:
    """Weight and bias of a layer of a sequence, which is a convolution with a bias."""
    assert isinstance(layer, nn.Conv2d) and layer.bias is not None
    return layer.weight, layer.bias


@torch.no_grad()
def start_small(layer: nn.Module) -> Tensor:
    """Let a convolution tell almost nothing, and return its bias, for what it is to tell."""
    weight, bias = conv(layer)
    nn.init.normal_(weight, std=SMALL)
    return nn.init.zeros_(bias)


def carriers(channels: int) -> tuple[tuple[int, float], ...]:
    """For red, green and blue a channel of a decoder that hardly any wave of its position embedding disturbs.

    They are those of the slowest waves of each direction. Cosines of them are nearly 1, a tenth of which is added to
    the map; the sine is under 0.01 in all but the thinnest decoders.

    Args:
        channels: Of the decoder at full size, a multiple of 4.

    Returns:
        Each colour's channel, and what the embedding adds to it.
    """
    quarter = channels // 4
    return ((2 * quarter - 1, 0.1), (4 * quarter - 1, 0.1), (quarter - 1, 0.0))
