"""Initial values for training without pretrained weights, or for a Gaussian head on pretrained ones."""

import math

import torch
from torch import nn

from anystyle.geometry.harmonics import CONSTANT
from anystyle.nn.pixels import IMAGENET_MEAN, IMAGENET_STD
from anystyle.nn.scratch import FIELD_OF_VIEW, OPACITY_LOGIT, PIXELS, SMALL, carriers, conv, start_small
from anystyle_depth_anything.embedder import Embedder
from anystyle_depth_anything.gaussian_head import GaussianHead
from anystyle_depth_anything.geometry_head import GeometryHead

LIFT = 6.0
"""Added to normalised colours, so that GELU and ReLU pass them on as they are."""


@torch.no_grad()
def start_from_scratch(embedder: Embedder, geometry_head: GeometryHead) -> None:
    """Depth of about 1, and cameras at the origin (see :mod:`anystyle.nn.scratch`).

    This chooses values alone; the published method starts from pretrained weights.
    """
    nn.init.normal_(embedder.cls_token, std=0.02)  # else layer norms see nothing but rounding
    decoder = geometry_head.camera
    for layer in (decoder.translation, decoder.quaternion, decoder.field_of_view):
        nn.init.normal_(layer.weight, std=0.1 * SMALL)
        nn.init.zeros_(layer.bias)
    decoder.quaternion.bias[3] = 1.0  # the real part of xyzw
    nn.init.constant_(decoder.field_of_view.bias, FIELD_OF_VIEW)
    start_small(geometry_head.depth.output[2])


@torch.no_grad()
def start_gaussians(head: GaussianHead, *, scale_min: float, scale_max: float) -> None:
    """Gaussians of their pixel's colour, about its footprint's size, of opacity 0.9, on the depth head's surface."""
    bias = start_small(head.dpt.output[2])
    # The adapter's unit is a tenth of two pixels.
    fraction = (PIXELS / 0.2 - scale_min) / (scale_max - scale_min)
    bias[2:5] = math.log(fraction / (1 - fraction))
    bias[8] = 1.0  # the real part of xyzw
    bias[-1] = OPACITY_LOGIT
    _pass_colors_on(head)


def _pass_colors_on(head: GaussianHead) -> None:
    """Open a way for red, green and blue from the image to the constant coefficients, through every layer."""
    neck, neck_bias = conv(head.dpt.neck)
    last, last_bias = conv(head.dpt.output[2])
    for color, (carrier, wave) in enumerate(carriers(head.direct_dim)):
        _connect(head.direct[0], color, color, LIFT)
        _connect(head.direct[2], color, color, 0.0)
        _connect(head.direct[4], carrier, color, 0.0)
        neck[carrier] = 0
        neck_bias[carrier] = 0
        _connect(head.dpt.output[0], color, carrier, -wave)
        start = 9 + color * head.coefficients
        last[start : start + head.coefficients] = 0
        last[start, color] = IMAGENET_STD[color] / CONSTANT
        last_bias[start : start + head.coefficients] = 0
        last_bias[start] = (IMAGENET_MEAN[color] - IMAGENET_STD[color] * LIFT - 0.5) / CONSTANT


def _connect(layer: nn.Module, to: int, source: int, offset: float) -> None:
    weight, bias = conv(layer)
    weight[to] = 0
    weight[to, source, 1, 1] = 1
    bias[to] = offset
