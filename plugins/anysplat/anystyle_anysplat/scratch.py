"""Initial values for training without pretrained weights (see :mod:`anystyle.nn.scratch`).

They are values alone; the published method starts from pretrained weights.
"""

import math

import torch
from torch import nn

from anystyle.contracts import Backbone
from anystyle.geometry.harmonics import CONSTANT
from anystyle.nn import scratch as initial
from anystyle_anysplat.embedder import Embedder
from anystyle_anysplat.gaussian_head import GaussianHead
from anystyle_anysplat.geometry_head import GeometryHead


@torch.no_grad()
def start_from_scratch(backbone: Backbone, *, focal_epsilon: float, scale_unit: float) -> None:
    """Initialise a network to show its photographs on a plane, with Gaussians about as large as its pixels."""
    embedder, geometry_head, gaussian_head = backbone.embedder, backbone.geometry_head, backbone.gaussian_head
    assert isinstance(embedder, Embedder) and isinstance(geometry_head, GeometryHead)
    assert isinstance(gaussian_head, GaussianHead)
    for token in (embedder.camera_token, embedder.register_token):
        nn.init.normal_(token, std=0.02)  # else the layer norms of the first block see no difference between views
    _start_geometry(geometry_head)
    footprint = 2 * (math.tan(initial.FIELD_OF_VIEW / 2) + focal_epsilon) / backbone.resolution  # of a pixel at depth 1
    _start_gaussians(gaussian_head, initial.PIXELS * footprint / scale_unit)


def _start_geometry(head: GeometryHead) -> None:
    """Cameras at the origin and depth of about 1."""
    step = torch.tensor([0, 0, 0, 0, 0, 0, 1, initial.FIELD_OF_VIEW, initial.FIELD_OF_VIEW]) / head.camera.iterations
    last = head.camera.pose_branch.fc2
    nn.init.normal_(last.weight, std=0.1 * initial.SMALL)
    last.bias.copy_(step)
    initial.start_small(head.depth.output[2])


def _start_gaussians(head: GaussianHead, scale: float) -> None:
    """Gaussians of their pixel's own colour, of opacity 0.9."""
    bias = initial.start_small(head.dpt.output[2])
    bias[0] = initial.OPACITY_LOGIT
    bias[1:4] = scale + math.log(-math.expm1(-scale))  # the inverse of softplus
    bias[7] = 1.0  # the real part of xyzw
    for color, (carrier, _) in enumerate(initial.carriers(head.direct_dim)):
        initial.connect(head.direct, carrier, color, 0.0)
    initial.pass_colors_on(head.dpt, 8, head.coefficients, [1 / CONSTANT] * 3, [-0.5 / CONSTANT] * 3)
