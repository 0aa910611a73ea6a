"""Initial values for training without pretrained weights: a network that places its photographs on a plane.

Depth is about 1, cameras stand at the origin, and every pixel is a Gaussian of its own colour and about its footprint's
size. All other weights start small, so that training starts from a picture and not from noise.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from anystyle_backbones.dpt import Dpt

_SIZES: dict[str, object] = {"resolution": 56, "native_resolution": 56, "dim": 32, "heads": 2, "sh_degree": 1}
_DECODERS = {"depth_features": 16, "depth_channels": (8, 8, 8, 8), "gaussian_channels": (8, 8, 8, 8)}
SMALL_NETWORK = {**_SIZES, **_DECODERS, "init": "scratch"}
"""Options that the backbones' examples share."""
FIELD_OF_VIEW = math.radians(55)
OPACITY = 0.9
OPACITY_LOGIT = math.log(OPACITY / (1 - OPACITY))
PIXELS = 0.5
"""Standard deviation of a Gaussian in footprints of its pixel: at a half, neighbours just overlap."""
SMALL = 0.01
"""Standard deviation of the weights of the last layers, which predict the departure from the plane."""


def conv(layer: nn.Module) -> tuple[Tensor, Tensor]:
    """Weight and bias of a convolution in a sequence of layers."""
    assert isinstance(layer, nn.Conv2d) and layer.bias is not None
    return layer.weight, layer.bias


@torch.no_grad()
def start_small(layer: nn.Module) -> Tensor:
    """Initialise a convolution near zero and return its bias."""
    weight, bias = conv(layer)
    nn.init.normal_(weight, std=SMALL)
    return nn.init.zeros_(bias)


@torch.no_grad()
def connect(layer: nn.Module, output: int, source: int, offset: float) -> None:
    """Make an output channel of a convolution one of its input channels plus an offset."""
    weight, bias = conv(layer)
    weight[output] = 0
    weight[output, source, weight.shape[2] // 2, weight.shape[3] // 2] = 1
    bias[output] = offset


@torch.no_grad()
def pass_colors_on(dpt: Dpt, first: int, coefficients: int, gain: Sequence[float], offset: Sequence[float]) -> None:
    """Route colours that image features add to the :func:`carriers` to the constant harmonics, unchanged.

    ``first`` is the decoder's first channel of harmonics, ``coefficients`` for each colour.
    """
    neck, neck_bias = conv(dpt.neck)
    last, last_bias = conv(dpt.output[2])
    for color, (carrier, wave) in enumerate(carriers(neck.shape[0])):
        neck[carrier] = 0
        neck_bias[carrier] = 0
        connect(dpt.output[0], color, carrier, -wave)
        start = first + color * coefficients
        last[start : start + coefficients] = 0
        last[start, color] = gain[color]
        last_bias[start : start + coefficients] = 0
        last_bias[start] = offset[color]


def carriers(channels: int) -> tuple[tuple[int, float], ...]:
    """For red, green and blue a channel that the position embedding hardly changes, and what it adds to it.

    They are those of the lowest frequencies: their cosines are nearly 1, a tenth of which is added to the map; the sine
    is under 0.01 in all but the thinnest decoders.
    """
    quarter = channels // 4
    return ((2 * quarter - 1, 0.1), (4 * quarter - 1, 0.1), (quarter - 1, 0.0))
