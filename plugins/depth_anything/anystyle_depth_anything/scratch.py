"""Initial values for training without pretrained weights, or for a Gaussian head on pretrained ones."""

import math

import torch
from torch import nn

from anystyle.geometry.harmonics import CONSTANT
from anystyle.nn.pixels import IMAGENET_MEAN, IMAGENET_STD
from anystyle_depth_anything.embedder import Embedder
from anystyle_depth_anything.gaussian_head import GaussianHead
from anystyle_depth_anything.geometry_head import GeometryHead

FIELD_OF_VIEW = math.radians(55)
OPACITY = 0.9
PIXELS = 0.5
"""Standard deviation of a Gaussian in footprints of its pixel: at a half, neighbours just overlap."""
SMALL = 0.01
LIFT = 6.0
"""Added to normalised colours, so that GELU and ReLU pass them on as they are."""


@torch.no_grad()
def start_from_scratch(embedder: Embedder, geometry_head: GeometryHead) -> None:
    """Depth of about 1, and cameras at the origin with a field of view of 55 degrees.

    What leads elsewhere starts small, so that learning departs from a picture and not from noise. This chooses values
    alone; the published method starts from pretrained weights.
    """
    nn.init.normal_(embedder.cls_token, std=0.02)  # else layer norms see nothing but rounding
    decoder = geometry_head.camera
    for layer in (decoder.translation, decoder.quaternion, decoder.field_of_view):
        nn.init.normal_(layer.weight, std=0.1 * SMALL)
        nn.init.zeros_(layer.bias)
    decoder.quaternion.bias[3] = 1.0  # the real part of xyzw
    nn.init.constant_(decoder.field_of_view.bias, FIELD_OF_VIEW)
    _start_small(_conv(geometry_head.depth.output[2]))


@torch.no_grad()
def start_gaussians(head: GaussianHead, *, scale_min: float, scale_max: float) -> None:
    """Gaussians of their pixel's own colour, about its footprint's size, of opacity 0.9, on the depth head's surface.

    Args:
        head: What starts.
        scale_min: Of the adapter.
        scale_max: Of the adapter.
    """
    last = _conv(head.dpt.output[2])
    bias = _start_small(last)
    # The adapter's unit is a tenth of two pixels.
    share = (PIXELS / 0.2 - scale_min) / (scale_max - scale_min)
    bias[2:5] = math.log(share / (1 - share))
    bias[8] = 1.0  # the real part of xyzw
    bias[-1] = math.log(OPACITY / (1 - OPACITY))
    _pass_colors_on(head)


def _conv(layer: nn.Module) -> nn.Conv2d:
    assert isinstance(layer, nn.Conv2d)
    return layer


def _bias(layer: nn.Conv2d) -> torch.Tensor:
    assert layer.bias is not None
    return layer.bias


def _start_small(layer: nn.Conv2d) -> torch.Tensor:
    nn.init.normal_(layer.weight, std=SMALL)
    return nn.init.zeros_(_bias(layer))


def _pass_colors_on(head: GaussianHead) -> None:
    """Open a way for red, green and blue from the image to the constant coefficients, through every layer.

    The way uses the channels whose position embedding varies least: the slowest waves of each direction. Cosines of
    them are nearly 1, which a bias takes off; the sine is under 0.01 in all but the thinnest decoders.
    """
    one, two, three = (_conv(head.direct[place]) for place in (0, 2, 4))
    first, last, neck = _conv(head.dpt.output[0]), _conv(head.dpt.output[2]), head.dpt.neck
    quarter = head.direct_dim // 4
    carriers = ((2 * quarter - 1, 0.1), (4 * quarter - 1, 0.1), (quarter - 1, 0.0))
    for color, (carrier, wave) in enumerate(carriers):
        _connect(one, color, color, LIFT)
        _connect(two, color, color, 0.0)
        _connect(three, carrier, color, 0.0)
        neck.weight[carrier] = 0
        _bias(neck)[carrier] = 0
        _connect(first, color, carrier, -wave)
        start = 9 + color * head.coefficients
        last.weight[start : start + head.coefficients] = 0
        last.weight[start, color] = IMAGENET_STD[color] / CONSTANT
        _bias(last)[start : start + head.coefficients] = 0
        _bias(last)[start] = (IMAGENET_MEAN[color] - IMAGENET_STD[color] * LIFT - 0.5) / CONSTANT


def _connect(layer: nn.Conv2d, to: int, source: int, bias: float) -> None:
    layer.weight[to] = 0
    layer.weight[to, source, 1, 1] = 1
    _bias(layer)[to] = bias
