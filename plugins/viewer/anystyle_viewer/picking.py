"""What a ray from the camera meets first."""

import torch
import torch.nn.functional as F

from anystyle.geometry.projection import covariances
from anystyle.types import Gaussians

Vector = tuple[float, float, float]


def surface_point(gaussians: Gaussians, origin: Vector, direction: Vector) -> Vector | None:
    """Where a ray through the Gaussians of one scene has lost half of its light; ``None`` if it never does."""
    start, way = gaussians.means.new_tensor(origin), F.normalize(gaussians.means.new_tensor(direction), dim=0)
    offsets = start - gaussians.means[0]
    precisions = torch.linalg.inv(covariances(gaussians.rotations[0], gaussians.scales[0]))
    steep = torch.einsum("i,nij,j->n", way, precisions, way)
    along = -torch.einsum("ni,nij,j->n", offsets, precisions, way) / steep  # where it is deepest inside each Gaussian
    deepest = offsets + along[:, None] * way
    squared = torch.einsum("ni,nij,nj->n", deepest, precisions, deepest)
    alpha = torch.where(along > 0, gaussians.opacities[0] * torch.exp(-squared / 2), 0)
    order = along.argsort()
    dark = (1 - alpha[order]).cumprod(0) <= 0.5
    if not bool(dark.any()):
        return None
    x, y, z = (start + way * along[order[dark.int().argmax()]]).tolist()
    return x, y, z
