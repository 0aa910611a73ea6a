"""Point maps: world points of the pixels as networks predict them, and cameras that see them there."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.alignment import resect
from anystyle.geometry.warp import pixels
from anystyle.types import Cameras
from anystyle_backbones.heads import centred_cameras

MOST_POINTS = 4096
"""Points of a view that its camera is fitted to."""
LEAST_FIELD, LARGEST_FIELD = math.radians(10), math.radians(150)
"""Bounds of the estimated field of view along the shorter side."""
SAMPLES = 50
"""Rows and columns, at least, of the pixels that a lens is fitted to, where an image has them."""


def points_of(raw: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Points in the direction of raw ones, at a distance that is exponential in theirs from 0."""
    distance = raw.norm(dim=-1, keepdim=True)
    return raw / distance.clamp_min(1e-8) * distance.expm1()


@torch.no_grad()
def cameras_of(points: Float[Tensor, "B V H W 3"]) -> Cameras:
    """Cameras that see each view's points at its pixels, the first in its place.

    The focal length is the one that the first view's points fit best (as in DUSt3R, arXiv 2312.14132, section 3.3), the
    same for all views, with the principal point in the middle; the poses of other views bring their points onto the
    pixels' rays.
    """
    batch, views, height, width, _ = points.shape
    step = max(1, math.isqrt(height * width // MOST_POINTS))
    # Few points, and all their digits: normal equations square the condition.
    chosen = points[:, :, ::step, ::step].double()
    places = pixels(points[0, 0, :, :, 0].double())[:, ::step, ::step].flatten(1).mT + 0.5  # P 2
    centred = places - places.new_tensor([width / 2, height / 2])
    chosen = chosen.flatten(2, 3)  # B V P 3
    focal = focal_of(chosen[:, 0], centred, min(height, width))  # B
    rotation = torch.eye(3, dtype=chosen.dtype, device=chosen.device).repeat(batch, views, 1, 1)
    origin = torch.zeros_like(rotation[..., 0])
    if views > 1:
        rays = (centred / focal[:, None, None])[:, None].expand(-1, views - 1, -1, -1).flatten(0, 1)
        scale = 2 / min(height, width)
        motion = resect(chosen[:, 1:].flatten(0, 1), rays, scale=scale)
        turned = motion.rotation.mT
        rotation[:, 1:] = turned.unflatten(0, (batch, -1))
        origin[:, 1:] = -torch.einsum("mij,mj->mi", turned, motion.translation).unflatten(0, (batch, -1))
    tangent = places.new_tensor([height / 2, width / 2]) / focal[:, None]
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


def lens_of(rays: Float[Tensor, "B V H W 3"]) -> Float[Tensor, "B V 4"]:
    """Focal lengths and principal point (fx, fy, cx, cy), in pixels whose places are their indices.

    They are those by which x / z and y / z of the rays fit columns and rows best, by least squares.

    Source: ``recover_pinhole_intrinsics_from_ray_directions`` (``mapanything/utils/geometry.py``) for images of up to a
    million pixels.
    """
    rows, columns = (
        torch.arange(0, side, max(1, side // SAMPLES), device=rays.device) for side in (rays.shape[2], rays.shape[3])
    )
    chosen = rays[:, :, rows[:, None], columns]
    away = chosen[..., 2:]
    slopes = chosen[..., :2] / torch.where(away.abs() < 1e-6, 1e-6, away)
    places = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1).to(rays.dtype)
    mean, middle = slopes.mean((2, 3)), places.mean((0, 1))
    centred = slopes - mean[:, :, None, None]
    focal = (centred * (places - middle)).sum((2, 3)) / centred.square().sum((2, 3)).clamp_min(1e-12)
    return torch.cat([focal, middle - focal * mean], dim=-1)


def renderable(lens: Float[Tensor, "B V 4"], size: tuple[int, int]) -> Float[Tensor, "B V 4"]:
    """A lens that can be rendered with: fields of view from 10 to 150 degrees, the principal point in the image.

    It changes nothing but what an untrained network predicts; there the published code has negative focal lengths too.
    """
    sides = lens.new_tensor([size[1], size[0]])
    least, largest = (sides / 2 / math.tan(field / 2) for field in (LARGEST_FIELD, LEAST_FIELD))
    return torch.cat([lens[..., :2].clamp(least, largest), lens[..., 2:].clamp(torch.zeros_like(sides), sides)], dim=-1)
