"""A ray caster for scenes of a few solids: colour by supersampling, depth exact at pixel centres."""

import numpy as np

from anystyle.compiled import compiled
from anystyle_tiny.procedural.light import hit_surroundings, shade
from anystyle_tiny.procedural.solids import BOUND, CENTRE, SOLIDS, Vector, dot, hit_solid, scaled

CALM = 0.05
"""Two samples of a pixel that differ by less than this fraction of their sum are enough."""


@compiled
def _ray(pose: np.ndarray, focal: float, height: int, width: int, row: float, column: float) -> Vector:
    """The world direction through a point of the image, of unit depth."""
    x, y = (column - width / 2) / focal, (row - height / 2) / focal
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2],
    )


@compiled
def _nearest(
    g: np.ndarray, solids: np.ndarray, chosen: np.ndarray, count: int, origin: Vector, ray: Vector
) -> tuple[float, int]:
    best, label = hit_surroundings(g, origin, ray)
    for i in chosen[:count]:
        t = hit_solid(solids, i, origin, ray, 1e-3)
        if t < best:
            best, label = t, i + SOLIDS
    return best, label


@compiled
def _bounds(solids: np.ndarray, pose: np.ndarray, focal: float, height: int, width: int) -> np.ndarray:
    """Rectangles of the image that hold the solids' bounding spheres: left, right, top, bottom."""
    bounds = np.empty((len(solids), 4), np.float64)
    for i in range(len(solids)):
        v = (solids[i, CENTRE] - pose[0, 3], solids[i, CENTRE + 1] - pose[1, 3], solids[i, CENTRE + 2] - pose[2, 3])
        r, cz = solids[i, BOUND], pose[0, 2] * v[0] + pose[1, 2] * v[1] + pose[2, 2] * v[2]
        for axis in range(2):
            middle = (height if axis else width) / 2
            c = pose[0, axis] * v[0] + pose[1, axis] * v[1] + pose[2, axis] * v[2]
            if cz + r <= 0:
                bounds[i, 2 * axis], bounds[i, 2 * axis + 1] = 1.0, 0.0
            elif cz - r <= 0.05:
                bounds[i, 2 * axis], bounds[i, 2 * axis + 1] = -1e9, 1e9
            else:
                lo, hi = c - r, c + r
                bounds[i, 2 * axis] = middle + focal * lo / (cz - r if lo < 0 else cz + r)
                bounds[i, 2 * axis + 1] = middle + focal * hi / (cz - r if hi > 0 else cz + r)
    return bounds


@compiled
def cast(
    g: np.ndarray,
    solids: np.ndarray,
    materials: np.ndarray,
    bytes_: np.ndarray,
    pose: np.ndarray,
    focal: float,
    color: np.ndarray,
    depth: np.ndarray,
    labels: np.ndarray,
    samples: int,
) -> None:
    """Fill ``color`` (H W 3, linear light), ``depth`` (H W, along the camera's z axis) and ``labels`` (H W)."""
    height, width = depth.shape
    origin = (pose[0, 3], pose[1, 3], pose[2, 3])
    bounds = _bounds(solids, pose, focal, height, width)
    in_row, chosen = np.empty(len(solids), np.int64), np.empty(len(solids), np.int64)
    for row in range(height):
        rows = 0
        for i in range(len(solids)):
            if bounds[i, 2] <= row + 1 and bounds[i, 3] >= row:
                in_row[rows] = i
                rows += 1
        for column in range(width):
            count = 0
            for i in in_row[:rows]:
                if bounds[i, 0] <= column + 1 and bounds[i, 1] >= column:
                    chosen[count] = i
                    count += 1
            ray = _ray(pose, focal, height, width, row + 0.5, column + 0.5)
            depth[row, column], labels[row, column] = _nearest(g, solids, chosen, count, origin, ray)
            red, green, blue, taken = 0.0, 0.0, 0.0, 0
            # The openness to ambient light is computed once for each thing that a pixel sees.
            last, known, contrast = labels[row, column], -1.0, 0.0
            for sample in range(samples * samples):
                if sample == 2 and samples == 2 and contrast < CALM * (red + green + blue):
                    break
                # For two samples a side: one diagonal first, then the other.
                i, j = sample // samples, sample % samples
                if samples == 2:
                    i, j = sample & 1, (sample & 1) ^ (sample >> 1)
                fy, fx = (i + 0.5) / samples, (j + 0.5) / samples
                ray = _ray(pose, focal, height, width, row + fy, column + fx)
                t, label = _nearest(g, solids, chosen, count, origin, ray)
                length = np.sqrt(dot(ray, ray))
                point = (origin[0] + t * ray[0], origin[1] + t * ray[1], origin[2] + t * ray[2])
                view, footprint = scaled(ray, length), t * length / (focal * samples) * 1.2
                jitter, openness = (2 * fx - 1, 2 * fy - 1), known if label == last else -1.0
                r, gr, b, known = shade(g, solids, materials, bytes_, label, point, view, footprint, jitter, openness)
                if label != last:
                    contrast = 1e9
                elif sample == 1:
                    contrast += abs(r - red) + abs(gr - green) + abs(b - blue)
                last, taken = label, taken + 1
                red, green, blue = red + r, green + gr, blue + b
            taken = max(taken, 1)
            color[row, column, 0], color[row, column, 1] = red / taken, green / taken
            color[row, column, 2] = blue / taken
