"""Fusion of points that share a voxel, as pure functions."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.types import Clusters


def voxel_clusters(points: Float[Tensor, "B M 3"], confidence: Float[Tensor, "B M"], voxel_size: float) -> Clusters:
    """Cluster world points by voxel, each weighted by the softmax of the confidences (logits) in its voxel.

    Voxels lie around the multiples of ``voxel_size`` (ties to even) and are numbered in lexicographic order. A point's
    weight is ``exp(c - max c) / (sum exp(c - max c) + 1e-6)`` over its voxel, and the voxel's mean the weighted sum.
    Differentiable in the points and confidences. Scenes are padded to one count; padding has mean 0 and no points.
    """
    if voxel_size <= 0:
        raise ValueError(f"voxel_size is {voxel_size}; it must be greater than 0")
    if not bool(points.isfinite().all()):
        raise ValueError("points to fuse are infinite or not a number; the predicted depth or cameras have diverged")
    cells = (points.detach() / voxel_size).round().long()
    index = torch.stack([lexicographic_ranks(scene) for scene in cells])
    counts = index.amax(dim=1) + 1
    size = int(counts.max())
    valid = torch.arange(size, device=points.device) < counts[:, None]
    weight = _softmax(confidence, index, size)
    unfused = Clusters(index=index, weight=weight, means=points.new_zeros(len(points), size, 3), valid=valid)
    return Clusters(index=index, weight=weight, means=fuse(points, unfused), valid=valid)


def fuse(values: Float[Tensor, "B M C"], clusters: Clusters) -> Float[Tensor, "B N C"]:
    """The weighted sum of the values of each cluster's points; padding gets 0. Linear in ``values``."""
    batch, _, channels = values.shape
    size = clusters.means.shape[1]
    weighted = values * clusters.weight[..., None].to(values.dtype)
    flat = _flat_index(clusters.index, size)[:, None].expand(-1, channels)
    total = values.new_zeros(batch * size, channels).scatter_add(0, flat, weighted.flatten(0, 1))
    return total.unflatten(0, (batch, size))


def lexicographic_ranks(cells: Int[Tensor, "M 3"]) -> Int[Tensor, " M"]:
    """The rank of each row among the distinct rows in lexicographic order."""
    lowest = cells.amin(dim=0)
    spans = [int(span) for span in cells.amax(dim=0) - lowest + 1]
    if math.prod(spans) < 2**63:
        x, y, z = (cells - lowest).unbind(-1)
        return torch.unique((x * spans[1] + y) * spans[2] + z, return_inverse=True)[1]
    # So wide a range has no room in one integer: join columns by their ranks, of which there are at most M.
    ranks = torch.unique(cells[:, 0], return_inverse=True)[1]
    for column in cells.T[1:]:
        distinct, column_ranks = torch.unique(column, return_inverse=True)
        ranks = torch.unique(ranks * len(distinct) + column_ranks, return_inverse=True)[1]
    return ranks


def _softmax(logits: Float[Tensor, "B M"], index: Int[Tensor, "B M"], size: int) -> Float[Tensor, "B M"]:
    flat, values = _flat_index(index, size), logits.flatten()
    count = len(logits) * size
    largest = values.new_full((count,), -torch.inf).scatter_reduce(0, flat, values.detach(), "amax")
    exponentials = (values - largest[flat]).exp()
    total = exponentials.new_zeros(count).scatter_add(0, flat, exponentials)
    return (exponentials / (total[flat] + 1e-6)).view_as(logits)


def _flat_index(index: Int[Tensor, "B M"], size: int) -> Int[Tensor, " BM"]:
    return (index + size * torch.arange(len(index), device=index.device)[:, None]).flatten()
