"""Depth fused into a surface: a truncated signed distance function (Curless and Levoy 1996), and marching cubes."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from torch import Tensor

from anystyle.errors import UserError
from anystyle_formats.mesh.depth import DepthViews, sampled

RESOLUTION = 192
"""Voxels along the longest side of a scene."""
BLUR = 1.0
"""Deviation of the blur of distances, in voxels: depth from Gaussians is rough."""
TRUNCATION, NOISE = 4.0, 0.02
"""Distances count so far before and behind a surface: in voxels, and at least as a part of the median depth."""
TAILS = 0.01
"""Share of the points, on each side of each axis, that do not count for where the scene ends."""
FEWEST, SMALLEST = 4, 0.01
"""Pieces with fewer faces, or fewer relative to the largest piece, are dropped."""
FEWEST_VIEWS = 0.5
"""Where fewer views, in a neighbourhood of the blur, see a voxel, nothing is known of it."""
NEAR = 3.0
"""A vertex is near within so many edges: marching cubes makes about one in each voxel that the surface crosses."""
MAX_POINTS, CHUNK = 1_000_000, 1 << 18
"""Points that say where a surface is, and voxels that are integrated at once."""
_NOTHING = "the views agree on no surface; there is nothing to mesh"


class Mesh(NamedTuple):
    """Triangles, counter-clockwise as seen from outside: vertices in the cameras' axes, with sRGB colours in [0, 1]."""

    vertices: Float[np.ndarray, "N 3"]
    faces: Int[np.ndarray, "M 3"]
    colors: Float[np.ndarray, "N 3"]


def coverage(mesh: Mesh, views: DepthViews) -> float:
    """The share of the surfaces that the views show that the mesh has, in [0, 1], from every fourth pixel and row.

    A pixel counts where a vertex is near the point that it shows: within :data:`NEAR` edges.
    """
    corners = mesh.vertices[mesh.faces]
    edge = float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
    shown = views.points[:, ::4, ::4][views.depth[:, ::4, ::4] > 0].numpy()
    distance, _ = KDTree(mesh.vertices).query(shown, distance_upper_bound=NEAR * edge)
    return float(np.isfinite(distance).mean())


def pieces(mesh: Mesh) -> Int[np.ndarray, " P"]:
    """How many faces each connected piece has, the largest first."""
    piece = _pieces(mesh.faces, len(mesh.vertices))
    return np.sort(np.bincount(piece[mesh.faces[:, 0]]))[::-1]


def fused(views: DepthViews, resolution: int = RESOLUTION) -> Mesh:
    """The surface that most views agree on.

    Raises:
        UserError: They agree on none.
    """
    points = views.points[views.agreed]
    if not len(points):
        raise UserError(_NOTHING)
    points = points[:: math.ceil(len(points) / MAX_POINTS)]
    low, voxel, shape = _grid(points, resolution)
    reach = max(TRUNCATION * voxel, NOISE * float(views.depth[views.agreed].median()))
    inside = ((points - low) / voxel).floor().long().clamp_min(0).minimum(torch.tensor(shape) - 1)
    near = np.zeros(shape, bool)
    near[tuple(inside.T.numpy())] = True
    near = maximum_filter(near, 2 * math.ceil(reach / voxel) + 1) > 0
    distance, weight = _integrated(views, low, voxel, near, reach)
    vertices, faces = _surface(distance, weight)
    vertices = vertices * voxel + low.numpy() + 0.5 * voxel
    return Mesh(vertices.astype(np.float32), faces, _colors(views, torch.from_numpy(vertices).float(), reach))


def _grid(points: Float[Tensor, "N 3"], resolution: int) -> tuple[Float[Tensor, "3"], float, tuple[int, int, int]]:
    """Corner, size of a voxel, and voxels along each axis."""
    low, high = points.quantile(TAILS, dim=0), points.quantile(1 - TAILS, dim=0)
    margin = 0.05 * float((high - low).max())
    if not margin:
        raise UserError("all that the views agree on is a single point; there is nothing to mesh")
    low, high = low - margin, high + margin
    voxel = float((high - low).max()) / resolution
    x, y, z = (max(2, int(side)) for side in ((high - low) / voxel).ceil())
    return low, voxel, (x, y, z)


def _integrated(
    views: DepthViews, low: Float[Tensor, "3"], voxel: float, near: NDArray[np.bool_], reach: float
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Mean signed distance to the surface where ``near``, as parts of ``reach``, and how many views count."""
    distance, weight = np.ones(near.shape, np.float32), np.zeros(near.shape, np.int16)
    agreed = replace(views, depth=torch.where(views.agreed, views.depth, 0))
    for voxels in np.array_split(np.argwhere(near), math.ceil(near.sum() / CHUNK)):
        centers = (torch.from_numpy(voxels) + 0.5) * voxel + low
        total, count = torch.zeros(len(centers)), torch.zeros(len(centers), dtype=torch.int16)
        for view in range(len(views.depth)):
            _, ahead, found = agreed.seen_at(view, centers)
            signed = (found - ahead) / reach
            counts = (found > 0) & (signed > -1)
            total += torch.where(counts, signed.clamp(max=1), 0)
            count += counts
        index = tuple(voxels.T)
        distance[index], weight[index] = torch.where(count > 0, total / count.clamp_min(1), 1), count
    return distance, weight


def _surface(distance: NDArray[np.float32], weight: NDArray[np.int16]) -> tuple[NDArray, NDArray]:
    """Vertices in voxels and faces, without small pieces."""
    from skimage.measure import marching_cubes

    near = gaussian_filter(weight.astype(np.float32), BLUR)
    distance = np.divide(gaussian_filter(distance * weight, BLUR), near, out=np.ones_like(near), where=near > 1e-6)
    known = near > FEWEST_VIEWS
    if not known.any() or not distance.min() < 0 < distance.max():
        raise UserError(_NOTHING)
    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    # A vertex lies on the line between two voxels; where nobody saw one of them there is no surface.
    seen = np.logical_and(*(known[tuple(end(vertices).astype(int).T)] for end in (np.floor, np.ceil)))
    faces = faces[seen[faces].all(1)]
    if not len(faces):
        raise UserError(_NOTHING)
    piece = _pieces(faces, len(vertices))
    sizes = np.bincount(piece[faces[:, 0]], minlength=piece.max() + 1)
    faces = faces[(sizes >= max(FEWEST, SMALLEST * sizes.max()))[piece[faces[:, 0]]]]
    if not len(faces):
        raise UserError("the views agree only on crumbs of a surface; there is nothing to mesh")
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used].astype(np.float64), faces.reshape(-1, 3)


def _pieces(faces: Int[np.ndarray, "M 3"], count: int) -> NDArray[np.int32]:
    """The number of the connected piece of each of ``count`` vertices."""
    ends = np.repeat(faces[:, 0], 2), faces[:, 1:].ravel()
    _, piece = connected_components(coo_matrix((np.ones(len(ends[0])), ends), (count, count)), directed=False)
    return piece


def _colors(views: DepthViews, vertices: Float[Tensor, "N 3"], reach: float) -> NDArray[np.float32]:
    """The mean colour of the views that see a vertex, near and at its depth; of its neighbour where none does."""
    total, weight = torch.zeros(3, len(vertices)), torch.zeros(len(vertices))
    for view in range(len(views.depth)):
        where, ahead, found = views.seen_at(view, vertices)
        near = (1 - (found - ahead).abs() / reach).clamp(0, 1) ** 2
        counts = torch.where(found > 0, near / ahead.clamp_min(1e-6) ** 2, 0)
        total += counts * sampled(views.color[view], where, "bilinear")
        weight += counts
    colors, seen = (total / weight.clamp_min(1e-12)).clamp(0, 1).T.numpy(), (weight > 0).numpy()
    if seen.any() and not seen.all():
        colors[~seen] = colors[seen][KDTree(vertices[seen].numpy()).query(vertices[~seen].numpy())[1]]
    return colors
