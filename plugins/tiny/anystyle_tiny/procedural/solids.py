"""Solids that rays meet: where, with what normal, and what they hide from each other.

The world's y axis points up and lengths are metres. A scene's solids are a table of numbers, with one row per solid.
"""

import numpy as np

from anystyle.compiled import compiled
from anystyle_tiny.procedural.volumes import turns

SPHERE, BOX, CYLINDER, CONE = range(4)

# Columns of a solid: kind, centre, half sizes and their inverses (in axes that are turned about y only), cosine and
# sine of the turn, radius of the bounding sphere, radius of the ball that dims what is near, index of its material.
SHAPE, CENTRE, HALF, INVERSE, COS, SIN, BOUND, BULK, PAINT = 0, 1, 4, 7, 10, 11, 12, 13, 14

FLOOR, WALL, CEILING, SOLIDS = range(4)
"""Labels of what a ray meets, and materials of the surroundings; solid i has the label SOLIDS + i."""

Pair = tuple[float, float]
Vector = tuple[float, float, float]


@compiled
def dot(a: Vector, b: Vector) -> float:
    """The inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def scaled(a: Vector, length: float) -> Vector:
    """A vector divided by a length."""
    return a[0] / length, a[1] / length, a[2] / length


@compiled
def from_point(solids: np.ndarray, i: int, point: Vector) -> Vector:
    """The vector from a point to the centre of a solid."""
    return solids[i, CENTRE] - point[0], solids[i, CENTRE + 1] - point[1], solids[i, CENTRE + 2] - point[2]


@compiled
def _hit_sphere(p: Vector, d: Vector, near: float) -> float:
    a, b, c = dot(d, d), dot(p, d), dot(p, p) - 1.0
    disc = b * b - a * c
    if disc <= 0:
        return np.inf
    t = (-b - np.sqrt(disc)) / a
    return t if t > near else np.inf


@compiled
def _hit_box(p: Vector, d: Vector, near: float) -> float:
    low, high = -np.inf, np.inf
    for axis in range(3):
        # A direction along a face divides by zero, which gives the infinities that the comparisons need.
        inverse = 1.0 / d[axis]
        a, b = (-1.0 - p[axis]) * inverse, (1.0 - p[axis]) * inverse
        low, high = max(low, min(a, b)), min(high, max(a, b))
    return low if low <= high and low > near else np.inf


@compiled
def _hit_round(p: Vector, d: Vector, near: float, slope: float) -> float:
    """A cylinder of radius 1 (slope 0) or a cone of radius 1 at y = -1 and 0 at y = 1 (slope 0.5)."""
    (px, py, pz), (dx, dy, dz), best = p, d, np.inf
    w, k = 1.0 - slope * (py + 1.0), slope * dy
    a = dx * dx + dz * dz - k * k
    b = px * dx + pz * dz + w * k
    c = px * px + pz * pz - w * w
    disc = b * b - a * c
    if disc > 0 and abs(a) > 1e-12:
        root = np.sqrt(disc)
        for sign in (-1.0, 1.0):
            t = (-b + sign * root) / a
            if near < t < best and abs(py + t * dy) <= 1.0:
                best = t
    if abs(dy) > 1e-12:
        for cap in (-1.0, 1.0):
            if cap > 0 and slope > 0:
                continue
            t = (cap - py) / dy
            x, z = px + t * dx, pz + t * dz
            if near < t < best and x * x + z * z <= 1.0:
                best = t
    return best


@compiled
def hit_solid(solids: np.ndarray, i: int, origin: Vector, ray: Vector, near: float) -> float:
    """Where a ray meets a solid, in lengths of its direction; infinite where it does not beyond ``near``."""
    c, s = solids[i, COS], solids[i, SIN]
    a, b, e = solids[i, INVERSE], solids[i, INVERSE + 1], solids[i, INVERSE + 2]
    wx, wy, wz = origin[0] - solids[i, CENTRE], origin[1] - solids[i, CENTRE + 1], origin[2] - solids[i, CENTRE + 2]
    p = ((c * wx - s * wz) * a, wy * b, (s * wx + c * wz) * e)
    d = ((c * ray[0] - s * ray[2]) * a, ray[1] * b, (s * ray[0] + c * ray[2]) * e)
    shape = solids[i, SHAPE]
    if shape == SPHERE:
        return _hit_sphere(p, d, near)
    if shape == BOX:
        return _hit_box(p, d, near)
    return _hit_round(p, d, near, 0.0 if shape == CYLINDER else 0.5)


@compiled
def surface(solids: np.ndarray, i: int, point: Vector) -> tuple[Vector, Vector, float, float]:
    """Normal, position in the solid's axes in metres and position on its unrolled surface, at a point of a solid."""
    c, s = solids[i, COS], solids[i, SIN]
    wx, wz = point[0] - solids[i, CENTRE], point[2] - solids[i, CENTRE + 2]
    lx, ly, lz = c * wx - s * wz, point[1] - solids[i, CENTRE + 1], s * wx + c * wz
    a, b, e = solids[i, HALF], solids[i, HALF + 1], solids[i, HALF + 2]
    ux, uy, uz = lx / a, ly / b, lz / e
    shape, slope = solids[i, SHAPE], 0.5 if solids[i, SHAPE] == CONE else 0.0
    flat = uy < -0.9999 or (uy > 0.9999 and slope == 0.0)
    if shape == BOX:
        flat = abs(uy) >= abs(ux) and abs(uy) >= abs(uz)
    if flat and shape != SPHERE:
        nx, ny, nz, u, v = 0.0, (1.0 if uy > 0 else -1.0), 0.0, lx, lz
    elif shape == BOX:
        if abs(ux) >= abs(uz):
            nx, ny, nz, u, v = (1.0 if ux > 0 else -1.0), 0.0, 0.0, lz, ly
        else:
            nx, ny, nz, u, v = 0.0, 0.0, (1.0 if uz > 0 else -1.0), lx, ly
    elif shape == SPHERE:
        nx, ny, nz, u, v = ux / a, uy / b, uz / e, 6.2831853 * turns(lz, lx) * a, uy * 1.4 * b
    else:
        nx, ny, nz, u, v = ux / a, slope * (1.0 - slope * (uy + 1.0)) / b, uz / e, 6.2831853 * turns(lz, lx) * a, ly
    nx, ny, nz = scaled((nx, ny, nz), np.sqrt(dot((nx, ny, nz), (nx, ny, nz))))
    return (c * nx + s * nz, ny, -s * nx + c * nz), (lx, ly, lz), u, v


@compiled
def shadowed(solids: np.ndarray, point: Vector, light: Vector, distance: float) -> bool:
    """Whether a solid stands between a point and the light at a distance along the unit vector ``light``."""
    for i in range(len(solids)):
        to_centre, bound = from_point(solids, i, point), solids[i, BOUND]
        along = dot(to_centre, light)
        if along < -bound or along > distance + bound:
            continue
        if dot(to_centre, to_centre) - along * along > bound * bound:
            continue
        if hit_solid(solids, i, point, light, 1e-4) < distance:
            return True
    return False


@compiled
def openness(solids: np.ndarray, label: int, point: Vector, normal: Vector) -> float:
    """Fraction of the ambient light that reaches a point past the solids; ``label`` is the one it lies on."""
    hidden = 0.0
    for i in range(len(solids)):
        to_centre = from_point(solids, i, point)
        toward, d2, r2 = dot(to_centre, normal), dot(to_centre, to_centre), solids[i, BULK] * solids[i, BULK]
        if toward > 0 and d2 < 40.0 * r2 and i + SOLIDS != label:
            hidden += min(r2 / d2 - 0.025, 0.95) * toward / np.sqrt(d2)
    return 1.0 / (1.0 + 0.9 * hidden)
