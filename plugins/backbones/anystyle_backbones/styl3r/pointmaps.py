"""Point maps: world points of the pixels as networks predict them, and cameras that see them there."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.warp import pixels
from anystyle.nn.tokens import constant
from anystyle.types import Cameras
from anystyle_backbones.alignment import resect
from anystyle_backbones.heads import centred_cameras

MOST_POINTS = 4096
"""Points of a view that its camera is fitted to."""
LEAST_FIELD, LARGEST_FIELD = math.radians(10), math.radians(150)
"""Bounds of the estimated field of view along the shorter side."""


def points_of(raw: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Points in the direction of raw ones, at a distance that is exponential in theirs from 0."""
    distance = raw.norm(dim=-1, keepdim=True)
    return raw / distance.clamp_min(1e-8) * distance.expm1()


@torch.no_grad()
def cameras_of(points: Float[Tensor, "B V H W 3"]) -> Cameras:
    """Cameras that see each view's points at its pixels; the first camera is the identity.

    The focal length is the one that the first view's points fit best (as in DUSt3R, arXiv 2312.14132, section 3.3), the
    same for all views, with the principal point in the middle; the poses of other views bring their points onto the
    pixels' rays.
    """
    batch, views, height, width, _ = points.shape
    step = max(1, math.isqrt(height * width // MOST_POINTS))
    # Few points, and all their digits: normal equations square the condition.
    chosen = points[:, :, ::step, ::step].double()
    places = pixels(points[0, 0, :, :, 0].double())[:, ::step, ::step].flatten(1).mT + 0.5  # P 2
    middle = constant((width / 2, height / 2), places.device, places.dtype)
    centred = places - middle
    chosen = chosen.flatten(2, 3)  # B V P 3
    focal = focal_of(chosen[:, 0], centred, min(height, width))  # B
    rotation = torch.eye(3, dtype=chosen.dtype, device=chosen.device).repeat(batch, views, 1, 1)
    origin = torch.zeros_like(rotation[..., 0])
    if views > 1:
        rays = (centred / focal[:, None, None])[:, None].expand(-1, views - 1, -1, -1).flatten(0, 1)
        motion = resect(chosen[:, 1:].flatten(0, 1), rays, scale=2 / min(height, width))
        turned = motion.rotation.mT
        rotation[:, 1:] = turned.unflatten(0, (batch, -1))
        origin[:, 1:] = -torch.einsum("mij,mj->mi", turned, motion.translation).unflatten(0, (batch, -1))
    tangent = middle.flip(0) / focal[:, None]
    cameras = centred_cameras(rotation, origin, tangent[:, None].expand(-1, views, -1), (height, width))
    return cameras.to(points.dtype)


def focal_of(points: Float[Tensor, "B P 3"], centred: Float[Tensor, "P 2"], short_side: int) -> Float[Tensor, " B"]:
    """The focal length in pixels by which a camera sees its own points at ``centred`` places, robustly (Weiszfeld)."""
    slopes = points[..., :2] / points[..., 2:].clamp_min(1e-6)
    ahead = (points[..., 2] > 1e-6).to(points.dtype)
    weight, focal = ahead, points.new_zeros(len(points))
    for _ in range(10):
        weighted = weight[..., None] * slopes
        focal = (weighted * centred).sum((1, 2)) / (weighted * slopes).sum((1, 2)).clamp_min(1e-12)
        weight = ahead / (centred - focal[:, None, None] * slopes).norm(dim=-1).clamp_min(1e-3)
    bounds = [short_side / 2 / math.tan(field / 2) for field in (LARGEST_FIELD, LEAST_FIELD)]
    return focal.clamp(*bounds)
