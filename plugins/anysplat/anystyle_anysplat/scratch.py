"""Initial values for training without pretrained weights (see :mod:`anystyle.nn.scratch`).

They are values alone; the published method starts from pretrained weights.
"""

import math

import torch
from torch import nn

from anystyle.contracts import Backbone
from anystyle.geometry.harmonics import CONSTANT
from anystyle.nn.scratch import FIELD_OF_VIEW, OPACITY_LOGIT, PIXELS, SMALL, carriers, conv, start_small
from anystyle_anysplat.embedder import Embedder
from anystyle_anysplat.gaussian_head import GaussianHead
from anystyle_anysplat.geometry_head import GeometryHead


@torch.no_grad()
def start_from_scratch(backbone: Backbone, *, focal_epsilon: float, scale_unit: float) -> None:
    """Let the untrained network show its photographs on a plane, by Gaussians about as large as its pixels.

    Args:
        backbone: An untrained one.
        focal_epsilon: See :func:`anystyle_anysplat.camera_head.decode_pose`.
        scale_unit: World units of a Gaussian's scale a unit of softplus.
    """
    embedder, geometry_head, gaussian_head = backbone.embedder, backbone.geometry_head, backbone.gaussian_head
    assert isinstance(embedder, Embedder) and isinstance(geometry_head, GeometryHead)
    assert isinstance(gaussian_head, GaussianHead)
    for token in (embedder.camera_token, embedder.register_token):
        nn.init.normal_(token, std=0.02)  # else the layer norms of the first block see no difference between views
    _start_geometry(geometry_head)
    footprint = 2 * (math.tan(FIELD_OF_VIEW / 2) + focal_epsilon) / backbone.resolution  # of a pixel at depth 1
    _start_gaussians(gaussian_head, PIXELS * footprint / scale_unit)


def _start_geometry(head: GeometryHead) -> None:
    """Cameras at the origin and depth of about 1."""
    step = torch.tensor([0, 0, 0, 0, 0, 0, 1, FIELD_OF_VIEW, FIELD_OF_VIEW]) / head.camera.iterations
    last = head.camera.pose_branch.fc2
    nn.init.normal_(last.weight, std=0.1 * SMALL)
    last.bias.copy_(step)
    start_small(head.depth.output[2])


def _start_gaussians(head: GaussianHead, scale: float) -> None:
    """Gaussians of their pixel's own colour, of opacity 0.9."""
    bias = start_small(head.dpt.output[2])
    bias[0] = OPACITY_LOGIT
    bias[1:4] = scale + math.log(-math.expm1(-scale))  # the inverse of softplus
    bias[7] = 1.0  # the real part of xyzw
    _pass_colors_on(head)


def _pass_colors_on(head: GaussianHead) -> None:
    """Open a way for red, green and blue from the image to the constant coefficients, through every layer."""
    direct, direct_bias = conv(head.direct)
    neck, neck_bias = conv(head.dpt.neck)
    first, first_bias = conv(head.dpt.output[0])
    last, last_bias = conv(head.dpt.output[2])
    for color, (carrier, offset) in enumerate(carriers(head.direct_dim)):
        direct[carrier] = 0
        direct[carrier, color, 3, 3] = 1
        direct_bias[carrier] = 0
        neck[carrier] = 0
        neck_bias[carrier] = 0
        first[color] = 0
        first[color, carrier, 1, 1] = 1
        first_bias[color] = -offset
        start = 8 + color * head.coefficients
        last[start : start + head.coefficients] = 0
        last[start, color] = 1 / CONSTANT
        last_bias[start : start + head.coefficients] = 0
        last_bias[start] = -0.5 / CONSTANT
