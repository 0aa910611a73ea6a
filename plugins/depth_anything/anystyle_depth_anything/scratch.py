"""Initial values for training without pretrained weights, or for a Gaussian head on pretrained ones."""

import math

import torch
from torch import nn

from anystyle.geometry.harmonics import CONSTANT
from anystyle.nn import scratch as initial
from anystyle.nn.tokens import IMAGENET_MEAN, IMAGENET_STD
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
        nn.init.normal_(layer.weight, std=0.1 * initial.SMALL)
        nn.init.zeros_(layer.bias)
    decoder.quaternion.bias[3] = 1.0  # the real part of xyzw
    nn.init.constant_(decoder.field_of_view.bias, initial.FIELD_OF_VIEW)
    initial.start_small(geometry_head.depth.output[2])


@torch.no_grad()
def start_gaussians(head: GaussianHead, *, scale_min: float, scale_max: float) -> None:
    """Gaussians of their pixel's colour, about its footprint's size, of opacity 0.9, on the depth head's surface."""
    bias = initial.start_small(head.dpt.output[2])
    # The adapter's unit is a tenth of two pixels.
    fraction = (initial.PIXELS / 0.2 - scale_min) / (scale_max - scale_min)
    bias[2:5] = math.log(fraction / (1 - fraction))
    bias[8] = 1.0  # the real part of xyzw
    bias[-1] = initial.OPACITY_LOGIT
    for color, (carrier, _) in enumerate(initial.carriers(head.direct_dim)):
        initial.connect(head.direct[0], color, color, LIFT)
        initial.connect(head.direct[2], color, color, 0.0)
        initial.connect(head.direct[4], carrier, color, 0.0)
    offset = [(mean - std * LIFT - 0.5) / CONSTANT for mean, std in zip(IMAGENET_MEAN, IMAGENET_STD, strict=True)]
    initial.pass_colors_on(head.dpt, 9, head.coefficients, [std / CONSTANT for std in IMAGENET_STD], offset)
