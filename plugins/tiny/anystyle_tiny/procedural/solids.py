"""Solids that rays meet: where, with what normal, and what they hide from each other.

The world's y axis points up and lengths are metres. A scene's solids are a table of numbers, a row a solid.
"""

import numpy as np

from anystyle.compiled import compiled

SPHERE, BOX, CYLINDER, CONE = range(4)

# Columns of a solid: kind, centre, half sizes and their inverses (in axes that are turned about y only), cosine and
# sine of the turn, radius of the bounding sphere, radius of the ball that dims what is near, index of its material.
SHAPE, CENTRE, HALF, INVERSE, COS, SIN, BOUND, BULK, PAINT = 0, 1, 4, 7, 10, 11, 12, 13, 14
SOLID_COLUMNS = 15

FLOOR, WALL, CEILING, SOLIDS = range(4)
"""Labels of what a ray meets, and materials of the surroundings; solid i has the label SOLIDS + i."""


@compiled
def _hit_sphere(px: float, py: float, pz: float, dx: float, dy: float, dz: float, near: float) -> float:
    a = dx * dx + dy * dy + dz * dz
    b = px * dx + py * dy + pz * dz
    c = px * px + py * py + pz * pz - 1.0
    disc = b * b - a * c
    if disc <= 0:
        return np.inf
    t = (-b - np.sqrt(disc)) / a
    return t if t > near else np.inf


@compiled
def _hit_box(px: float, py: float, pz: float, dx: float, dy: float, dz: float, near: float) -> float:
    # A direction along a face divides by zero, which gives the infinities that the comparisons need.
    ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
    ax, bx = (-1.0 - px) * ix, (1.0 - px) * ix
    ay, by = (-1.0 - py) * iy, (1.0 - py) * iy
    az, bz = (-1.0 - pz) * iz, (1.0 - pz) * iz
    lo = max(max(min(ax, bx), min(ay, by)), min(az, bz))
    hi = min(min(max(ax, bx), max(ay, by)), max(az, bz))
    return lo if lo <= hi and lo > near else np.inf


@compiled
def _hit_round(px: float, py: float, pz: float, dx: float, dy: float, dz: float, near: float, slope: float) -> float:
    """A cylinder of radius 1 (slope 0) or a cone of radius 1 at y = -1 and 0 at y = 1 (slope 0.5)."""
    best = np.inf
    w = 1.0 - slope * (py + 1.0)
    k = slope * dy
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
            if near < t < best:
                x, z = px + t * dx, pz + t * dz
                if x * x + z * z <= 1.0:
                    best = t
    return best


@compiled
def hit_solid(
    solids: np.ndarray, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, near: float
) -> float:
    """Where a ray meets a solid, in lengths of its direction; infinite where it does not beyond ``near``."""
    c, s = solids[i, COS], solids[i, SIN]
    a, b, e = solids[i, INVERSE], solids[i, INVERSE + 1], solids[i, INVERSE + 2]
    wx, wy, wz = ox - solids[i, CENTRE], oy - solids[i, CENTRE + 1], oz - solids[i, CENTRE + 2]
    px, py, pz = (c * wx - s * wz) * a, wy * b, (s * wx + c * wz) * e
    ex, ey, ez = (c * dx - s * dz) * a, dy * b, (s * dx + c * dz) * e
    shape = solids[i, SHAPE]
    if shape == SPHERE:
        return _hit_sphere(px, py, pz, ex, ey, ez, near)
    if shape == BOX:
        return _hit_box(px, py, pz, ex, ey, ez, near)
    return _hit_round(px, py, pz, ex, ey, ez, near, 0.0 if shape == CYLINDER else 0.5)


@compiled
def _angle(y: float, x: float) -> float:
    """The angle of (x, y) in (-pi, pi], continuous to 1e-3: enough to wrap a pattern around."""
    ax, ay = abs(x), abs(y)
    a = min(ax, ay) / max(max(ax, ay), 1e-12)
    s = a * a
    r = ((-0.0464964749 * s + 0.15931422) * s - 0.327622764) * s * a + a
    if ay > ax:
        r = 1.57079637 - r
    if x < 0:
        r = 3.14159274 - r
    return -r if y < 0 else r


@compiled
def surface(
    solids: np.ndarray, i: int, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Normal, place in the solid's axes in metres and place on its unrolled surface, at a point of a solid."""
    wx, wz = x - solids[i, CENTRE], z - solids[i, CENTRE + 2]
    lx, ly, lz = (
        solids[i, COS] * wx - solids[i, SIN] * wz,
        y - solids[i, CENTRE + 1],
        solids[i, SIN] * wx + solids[i, COS] * wz,
    )
    ux, uy, uz = lx / solids[i, HALF], ly / solids[i, HALF + 1], lz / solids[i, HALF + 2]
    if solids[i, SHAPE] == BOX:
        ax, ay, az = abs(ux), abs(uy), abs(uz)
        if ay >= ax and ay >= az:
            nx, ny, nz, u, v = 0.0, (1.0 if uy > 0 else -1.0), 0.0, lx, lz
        elif ax >= az:
            nx, ny, nz, u, v = (1.0 if ux > 0 else -1.0), 0.0, 0.0, lz, ly
        else:
            nx, ny, nz, u, v = 0.0, 0.0, (1.0 if uz > 0 else -1.0), lx, ly
    elif solids[i, SHAPE] == SPHERE:
        nx, ny, nz = ux / solids[i, HALF], uy / solids[i, HALF + 1], uz / solids[i, HALF + 2]
        u, v = _angle(lz, lx) * solids[i, HALF], uy * 1.4 * solids[i, HALF + 1]
    else:
        slope = 0.0 if solids[i, SHAPE] == CYLINDER else 0.5
        if uy < -0.9999 or (uy > 0.9999 and slope == 0.0):
            nx, ny, nz, u, v = 0.0, (1.0 if uy > 0 else -1.0), 0.0, lx, lz
        else:
            nx, ny, nz = (
                ux / solids[i, HALF],
                slope * (1.0 - slope * (uy + 1.0)) / solids[i, HALF + 1],
                uz / solids[i, HALF + 2],
            )
            u, v = _angle(lz, lx) * solids[i, HALF], ly
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    return solids[i, COS] * nx + solids[i, SIN] * nz, ny, -solids[i, SIN] * nx + solids[i, COS] * nz, lx, ly, lz, u, v


@compiled
def shadowed(solids: np.ndarray, x: float, y: float, z: float, lx: float, ly: float, lz: float, reach: float) -> bool:
    """Whether a solid stands between a point and the light at distance ``reach`` along the unit (lx, ly, lz)."""
    for i in range(len(solids)):
        vx, vy, vz = solids[i, CENTRE] - x, solids[i, CENTRE + 1] - y, solids[i, CENTRE + 2] - z
        along = vx * lx + vy * ly + vz * lz
        if along < -solids[i, BOUND] or along > reach + solids[i, BOUND]:
            continue
        if vx * vx + vy * vy + vz * vz - along * along > solids[i, BOUND] * solids[i, BOUND]:
            continue
        if hit_solid(solids, i, x, y, z, lx, ly, lz, 1e-4) < reach:
            return True
    return False


@compiled
def openness(solids: np.ndarray, label: int, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Share of the ambient light that reaches a point past the solids; ``label`` is the one it lies on."""
    hidden = 0.0
    for i in range(len(solids)):
        vx, vy, vz = solids[i, CENTRE] - x, solids[i, CENTRE + 1] - y, solids[i, CENTRE + 2] - z
        toward = vx * nx + vy * ny + vz * nz
        d2, r2 = vx * vx + vy * vy + vz * vz, solids[i, BULK] * solids[i, BULK]
        if toward > 0 and d2 < 40.0 * r2 and i + SOLIDS != label:
            hidden += min(r2 / d2 - 0.025, 0.95) * toward / np.sqrt(d2)
    return 1.0 / (1.0 + 0.9 * hidden)
