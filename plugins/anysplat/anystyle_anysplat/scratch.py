"""Initial values for training without pretrained weights."""

import math

import torch
from torch import nn

from anystyle_anysplat.embedder import Embedder
from anystyle_anysplat.gaussian_head import GaussianHead
from anystyle_anysplat.geometry_head import GeometryHead

FIELD_OF_VIEW = math.radians(55)
OPACITY = 0.9
PIXELS = 0.5
"""Standard deviation of a Gaussian in footprints of its pixel: at a half, neighbours just overlap."""
SMALL = 0.01
SH_CONSTANT = 0.28209479177387814


@torch.no_grad()
def start_from_scratch(
    embedder: Embedder,
    geometry_head: GeometryHead,
    gaussian_head: GaussianHead,
    *,
    resolution: int,
    focal_epsilon: float,
    scale_unit: float,
) -> None:
    """Let the untrained network show its photographs on a plane, one Gaussian a pixel.

    Depth is about 1, cameras stand at the origin with a field of view of 55 degrees, and Gaussians have their
    pixel's own colour, about its footprint's size and opacity 0.9. What leads elsewhere starts small, so that
    learning departs from a picture and not from noise. This chooses values alone; the published method starts from
    pretrained weights.
    """
    for token in (embedder.camera_token, embedder.register_token):
        nn.init.normal_(token, std=0.02)  # else the layer norms of the first block see no difference between views
    _start_cameras(geometry_head)
    _start_small(geometry_head.depth.output[2])
    _start_gaussians(gaussian_head, resolution=resolution, focal_epsilon=focal_epsilon, scale_unit=scale_unit)
    _pass_colors_on(gaussian_head)


def _start_cameras(head: GeometryHead) -> None:
    step = torch.tensor([0, 0, 0, 0, 0, 0, 1, FIELD_OF_VIEW, FIELD_OF_VIEW]) / head.camera.iterations
    last = head.camera.pose_branch.fc2
    nn.init.normal_(last.weight, std=0.1 * SMALL)
    last.bias.copy_(step)


def _start_small(layer: nn.Module) -> None:
    assert isinstance(layer, nn.Conv2d) and layer.bias is not None
    nn.init.normal_(layer.weight, std=SMALL)
    nn.init.zeros_(layer.bias)


def _start_gaussians(head: GaussianHead, *, resolution: int, focal_epsilon: float, scale_unit: float) -> None:
    last = head.dpt.output[2]
    _start_small(last)
    assert isinstance(last, nn.Conv2d) and last.bias is not None
    footprint = 2 * (math.tan(FIELD_OF_VIEW / 2) + focal_epsilon) / resolution  # of a pixel at depth 1
    softplus = PIXELS * footprint / scale_unit
    last.bias[0] = math.log(OPACITY / (1 - OPACITY))
    last.bias[1:4] = softplus + math.log(-math.expm1(-softplus))
    last.bias[7] = 1.0  # the real part of xyzw


def _pass_colors_on(head: GaussianHead) -> None:
    """Open a way for red, green and blue from the image to the constant coefficients, through every layer.

    The way uses the channels whose position embedding varies least: the slowest waves of each direction. Cosines of
    them are nearly 1, which a bias takes off; the sine is under 0.01 in all but the thinnest decoders.
    """
    first, last, neck = head.dpt.output[0], head.dpt.output[2], head.dpt.neck
    assert isinstance(first, nn.Conv2d) and isinstance(last, nn.Conv2d)
    assert first.bias is not None and last.bias is not None and neck.bias is not None and head.direct.bias is not None
    quarter = head.direct_dim // 4
    carriers = ((2 * quarter - 1, 0.1), (4 * quarter - 1, 0.1), (quarter - 1, 0.0))
    for color, (carrier, offset) in enumerate(carriers):
        head.direct.weight[carrier] = 0
        head.direct.weight[carrier, color, 3, 3] = 1
        head.direct.bias[carrier] = 0
        neck.weight[carrier] = 0
        neck.bias[carrier] = 0
        first.weight[color] = 0
        first.weight[color, carrier, 1, 1] = 1
        first.bias[color] = -offset
        start = 8 + color * head.coefficients
        last.weight[start : start + head.coefficients] = 0
        last.weight[start, color] = 1 / SH_CONSTANT
        last.bias[start : start + head.coefficients] = 0
        last.bias[start] = -0.5 / SH_CONSTANT
