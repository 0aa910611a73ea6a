"""A ray caster for scenes of a few solids: colour by supersampling, depth exact at pixel centres.

The world's y axis points up here; lengths are metres. A scene is three tables: solids, materials and one row of
settings, whose columns are named below.
"""

from typing import no_type_check

import numpy as np

from anystyle.compiled import compiled
from anystyle.data.procedural.textures import GLOSS, Tiles, albedo, rough

SPHERE, BOX, CYLINDER, CONE = range(4)

# Columns of a solid: kind, centre, half sizes (the world is turned about y only), cosine and sine of the turn,
# radius of the bounding sphere, radius of the ball that darkens what is near, index of its material.
SHAPE, CENTRE, HALF, COS, SIN, BOUND, BULK, PAINT = 0, 1, 4, 7, 8, 9, 10, 11
SOLID_COLUMNS = 12

# Columns of the settings: whether it is a room, half extents of the room in x and z and its height (or the dome's
# radius), the light (direction or place, whether it is a place, radius of its disk), its colour, colours of the
# ambient from above and below, sky colours at the horizon and the zenith, cloudiness, colour and height of hills.
ROOM, EXTENT, LIGHT, NEARBY, SPREAD, SUN, ABOVE, BELOW, HORIZON, ZENITH, CLOUDS, HILLS, HILL_HEIGHT = (
    0,
    1,
    4,
    7,
    8,
    9,
    12,
    15,
    18,
    21,
    24,
    25,
    28,
)
SETTING_COLUMNS = 29

FLOOR, WALL, CEILING = 0, 1, 2
"""Materials of the surroundings; they are also the labels of what a pixel sees. Solids follow from SOLIDS on."""
SOLIDS = 3


@compiled
@no_type_check
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
@no_type_check
def _hit_box(px: float, py: float, pz: float, dx: float, dy: float, dz: float, near: float) -> float:
    lo, hi = -np.inf, np.inf
    for p, d in ((px, dx), (py, dy), (pz, dz)):
        if abs(d) < 1e-12:
            if abs(p) > 1.0:
                return np.inf
            continue
        a, b = (-1.0 - p) / d, (1.0 - p) / d
        if a > b:
            a, b = b, a
        lo, hi = max(lo, a), min(hi, b)
    return lo if lo <= hi and lo > near else np.inf


@compiled
@no_type_check
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
@no_type_check
def _hit_solid(
    solids: np.ndarray, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, near: float
) -> float:
    px, py, pz = ox - solids[i, CENTRE], (oy - solids[i, CENTRE + 1]) / solids[i, HALF + 1], oz - solids[i, CENTRE + 2]
    px, pz = (
        (solids[i, COS] * px - solids[i, SIN] * pz) / solids[i, HALF],
        (solids[i, SIN] * px + solids[i, COS] * pz) / solids[i, HALF + 2],
    )
    ex, ey, ez = (
        (solids[i, COS] * dx - solids[i, SIN] * dz) / solids[i, HALF],
        dy / solids[i, HALF + 1],
        (solids[i, SIN] * dx + solids[i, COS] * dz) / solids[i, HALF + 2],
    )
    if solids[i, SHAPE] == SPHERE:
        return _hit_sphere(px, py, pz, ex, ey, ez, near)
    if solids[i, SHAPE] == BOX:
        return _hit_box(px, py, pz, ex, ey, ez, near)
    return _hit_round(px, py, pz, ex, ey, ez, near, 0.0 if solids[i, SHAPE] == CYLINDER else 0.5)


@compiled
@no_type_check
def _hit_surroundings(
    g: np.ndarray, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, int]:
    """The floor, walls and ceiling of a room, or the ground and the dome of the sky."""
    best, label = np.inf, WALL
    if dy < -1e-9:
        best, label = -oy / dy, FLOOR
    if g[ROOM] > 0:
        if dy > 1e-9:
            best, label = (g[EXTENT + 1] - oy) / dy, CEILING
        if abs(dx) > 1e-9:
            t = ((g[EXTENT] if dx > 0 else -g[EXTENT]) - ox) / dx
            if t < best:
                best, label = t, WALL
        if abs(dz) > 1e-9:
            t = ((g[EXTENT + 2] if dz > 0 else -g[EXTENT + 2]) - oz) / dz
            if t < best:
                best, label = t, WALL
        return best, label
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz - g[EXTENT] * g[EXTENT]
    t = (-b + np.sqrt(max(b * b - a * c, 0.0))) / a
    if t < best:
        best, label = t, WALL
    return best, label


@compiled
@no_type_check
def _sky(g: np.ndarray, x: float, y: float, z: float, noise: np.ndarray) -> tuple[float, float, float]:
    """Light of the dome at a point of it."""
    r = g[EXTENT]
    x, y, z = x / r, max(y / r, 0.0), z / r
    ridge = g[HILL_HEIGHT] * (1.0 + 0.8 * rough(noise, x * 1.3 + 5.1, 0.5, z * 1.3, 0.01))
    if y < ridge:
        haze = 0.35 + 0.45 * y / max(ridge, 1e-6)
        shade = haze * (1.0 + 0.15 * rough(noise, x * 6, y * 6, z * 6, 0.01))
        return (
            g[HILLS] * shade + g[HORIZON] * (1 - haze),
            g[HILLS + 1] * shade + g[HORIZON + 1] * (1 - haze),
            g[HILLS + 2] * shade + g[HORIZON + 2] * (1 - haze),
        )
    up = np.sqrt(y)
    flat = 1.0 / (y + 0.25)
    cloud = rough(noise, x * flat * 0.45, 0.3, z * flat * 0.45, 0.01) + g[CLOUDS] - 0.5
    cloud = min(max(cloud * 1.6, 0.0), 0.9) * min(6 * y, 1.0)
    return (
        (g[HORIZON] * (1 - up) + g[ZENITH] * up) * (1 - cloud) + 0.95 * cloud,
        (g[HORIZON + 1] * (1 - up) + g[ZENITH + 1] * up) * (1 - cloud) + 0.95 * cloud,
        (g[HORIZON + 2] * (1 - up) + g[ZENITH + 2] * up) * (1 - cloud) + 0.97 * cloud,
    )


@compiled
@no_type_check
def _surface(
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
@no_type_check
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
@no_type_check
def _openness(
    g: np.ndarray,
    solids: np.ndarray,
    label: int,
    x: float,
    y: float,
    z: float,
    nx: float,
    ny: float,
    nz: float,
) -> float:
    """Share of the ambient light that reaches a point past the solids and the corners of the room."""
    hidden = 0.0
    for i in range(len(solids)):
        if i + SOLIDS == label:
            continue
        vx, vy, vz = solids[i, CENTRE] - x, solids[i, CENTRE + 1] - y, solids[i, CENTRE + 2] - z
        d2 = max(vx * vx + vy * vy + vz * vz, 1e-6)
        toward = vx * nx + vy * ny + vz * nz
        if toward > 0:
            r2 = solids[i, BULK] * solids[i, BULK]
            hidden += min(r2 / d2, 1.0) * toward / np.sqrt(d2)
    left = 1.0 / (1.0 + 0.9 * hidden)
    left *= 1.0 - 0.45 * (0.5 - 0.5 * ny) / (1.0 + y * y * 4.0)
    if g[ROOM] > 0:
        dx, dz = g[EXTENT] - abs(x), g[EXTENT + 2] - abs(z)
        left *= 1.0 - 0.3 * (1.0 - abs(nx)) / (1.0 + dx * dx * 6.0)
        left *= 1.0 - 0.3 * (1.0 - abs(nz)) / (1.0 + dz * dz * 6.0)
    return left


@compiled
@no_type_check
def _shadowed(solids: np.ndarray, x: float, y: float, z: float, lx: float, ly: float, lz: float, reach: float) -> bool:
    """Whether a solid stands between a point and the light at distance ``reach`` along the unit (lx, ly, lz)."""
    for i in range(len(solids)):
        vx, vy, vz = solids[i, CENTRE] - x, solids[i, CENTRE + 1] - y, solids[i, CENTRE + 2] - z
        along = vx * lx + vy * ly + vz * lz
        if along < -solids[i, BOUND] or along > reach + solids[i, BOUND]:
            continue
        if vx * vx + vy * vy + vz * vz - along * along > solids[i, BOUND] * solids[i, BOUND]:
            continue
        if _hit_solid(solids, i, x, y, z, lx, ly, lz, 1e-4) < reach:
            return True
    return False


@compiled
@no_type_check
def _lit(
    g: np.ndarray,
    solids: np.ndarray,
    place: tuple[float, float, float],
    normal: tuple[float, float, float],
    view: tuple[float, float, float],
    jitter: tuple[float, float],
    label: int,
    gloss: float,
) -> tuple[float, float, float, float]:
    """Red, green and blue light that a point scatters, and what it mirrors of the lamp."""
    x, y, z = place
    nx, ny, nz = normal
    lx, ly, lz, reach, fall = g[LIGHT], g[LIGHT + 1], g[LIGHT + 2], 1e9, 1.0
    # The light is a disk in the horizontal plane; each sub-pixel sees one fixed point of it, so that penumbras are
    # the same from everywhere.
    lx, lz = lx + g[SPREAD] * jitter[0], lz + g[SPREAD] * jitter[1]
    if g[NEARBY] > 0:
        lx, ly, lz = lx - x, ly - y, lz - z
    length = np.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx / length, ly / length, lz / length
    if g[NEARBY] > 0:
        reach = length
        fall = 2.0 * g[NEARBY] * g[NEARBY] / (g[NEARBY] * g[NEARBY] + length * length)
    facing = nx * lx + ny * ly + nz * lz
    direct, mirror = 0.0, 0.0
    if facing > 0 and not _shadowed(solids, x + 1e-4 * nx, y + 1e-4 * ny, z + 1e-4 * nz, lx, ly, lz, reach):
        direct = facing * fall
        if gloss > 0:
            hx, hy, hz = lx - view[0], ly - view[1], lz - view[2]
            half = (hx * nx + hy * ny + hz * nz) / np.sqrt(max(hx * hx + hy * hy + hz * hz, 1e-9))
            half = max(half, 0.0)
            half *= half
            half *= half
            half *= half
            half *= half
            mirror = gloss * half * half * fall
    open_ = _openness(g, solids, label, x, y, z, nx, ny, nz)
    up = 0.5 + 0.5 * ny
    return (
        g[SUN] * direct + (g[ABOVE] * up + g[BELOW] * (1 - up)) * open_,
        g[SUN + 1] * direct + (g[ABOVE + 1] * up + g[BELOW + 1] * (1 - up)) * open_,
        g[SUN + 2] * direct + (g[ABOVE + 2] * up + g[BELOW + 2] * (1 - up)) * open_,
        mirror,
    )


@compiled
@no_type_check
def _nearest(
    g: np.ndarray,
    solids: np.ndarray,
    chosen: np.ndarray,
    count: int,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
) -> tuple[float, int]:
    best, label = _hit_surroundings(g, ox, oy, oz, dx, dy, dz)
    for k in range(count):
        i = chosen[k]
        t = _hit_solid(solids, i, ox, oy, oz, dx, dy, dz, 1e-3)
        if t < best:
            best, label = t, i + SOLIDS
    return best, label


@compiled
@no_type_check
def _shade(
    g: np.ndarray,
    solids: np.ndarray,
    materials: np.ndarray,
    volumes: Tiles,
    label: int,
    place: tuple[float, float, float],
    ray: tuple[float, float, float],
    footprint: float,
    jitter: tuple[float, float],
) -> tuple[float, float, float]:
    """Linear light that leaves a point toward the camera; ``ray`` is of unit length."""
    noise, leaves, cells, edges = volumes
    x, y, z = place
    if label == WALL and g[ROOM] == 0:
        return _sky(g, x, y, z, noise)
    lx, ly, lz = x, y, z
    if label >= SOLIDS:
        nx, ny, nz, lx, ly, lz, u, v = _surface(solids, label - SOLIDS, x, y, z)
        m = int(solids[label - SOLIDS, PAINT])
    elif label == FLOOR:
        nx, ny, nz, u, v, m = 0.0, 1.0, 0.0, x, z, FLOOR
    elif label == CEILING:
        nx, ny, nz, u, v, m = 0.0, -1.0, 0.0, x, z, CEILING
    elif g[EXTENT] - abs(x) < g[EXTENT + 2] - abs(z):
        nx, ny, nz, u, v, m = (-1.0 if x > 0 else 1.0), 0.0, 0.0, z, y, WALL
    else:
        nx, ny, nz, u, v, m = 0.0, 0.0, (-1.0 if z > 0 else 1.0), x, y, WALL
    grazing = max(abs(nx * ray[0] + ny * ray[1] + nz * ray[2]), 0.12)
    r, gr, b = albedo(materials, m, lx, ly, lz, u, v, footprint / grazing, noise, leaves, cells, edges)
    lr, lg, lb, mirror = _lit(g, solids, place, (nx, ny, nz), ray, jitter, label, materials[m, GLOSS])
    r, gr, b = r * lr + mirror * g[SUN], gr * lg + mirror * g[SUN + 1], b * lb + mirror * g[SUN + 2]
    if label == FLOOR and g[ROOM] == 0:
        # The ground fades into the haze where it meets the dome.
        far = (x * x + z * z) / (g[EXTENT] * g[EXTENT])
        far *= far * 0.8
        r, gr, b = (
            r * (1 - far) + g[HORIZON] * far * 0.8,
            gr * (1 - far) + g[HORIZON + 1] * far * 0.8,
            b * (1 - far) + g[HORIZON + 2] * far * 0.8,
        )
    return r, gr, b


@compiled
@no_type_check
def cast(
    g: np.ndarray,
    solids: np.ndarray,
    materials: np.ndarray,
    volumes: Tiles,
    pose: np.ndarray,
    focal: float,
    color: np.ndarray,
    depth: np.ndarray,
    labels: np.ndarray,
    samples: int,
) -> None:
    """Fill ``color`` (H W 3, linear light), ``depth`` (H W, along the camera's z axis) and ``labels`` (H W).

    Args:
        g: Settings of the scene.
        solids: A row a solid.
        materials: A row a material.
        volumes: The tiles of :func:`anystyle.data.procedural.textures.tiles`.
        pose: World from camera, 4x4, OpenCV axes in the camera, y up in the world.
        focal: In pixels; the principal point is the middle of the image.
        color: Written to.
        depth: Written to.
        labels: Written to: what is seen at the pixel's centre.
        samples: Rays a pixel's side for colour.
    """
    height, width = depth.shape
    count = len(solids)
    # A solid's bounding sphere lies in a rectangle of the image; conservative by the sphere's nearest depth.
    bounds = np.empty((count, 4), np.float64)
    ox, oy, oz = pose[0, 3], pose[1, 3], pose[2, 3]
    for i in range(count):
        vx, vy, vz = solids[i, CENTRE] - ox, solids[i, CENTRE + 1] - oy, solids[i, CENTRE + 2] - oz
        cx = pose[0, 0] * vx + pose[1, 0] * vy + pose[2, 0] * vz
        cy = pose[0, 1] * vx + pose[1, 1] * vy + pose[2, 1] * vz
        cz = pose[0, 2] * vx + pose[1, 2] * vy + pose[2, 2] * vz
        near, far = cz - solids[i, BOUND], cz + solids[i, BOUND]
        if far <= 0:
            bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3] = 1, 0, 1, 0
        elif near <= 0.05:
            bounds[i, 0], bounds[i, 1], bounds[i, 2], bounds[i, 3] = -1e9, 1e9, -1e9, 1e9
        else:
            x0, x1, y0, y1 = cx - solids[i, BOUND], cx + solids[i, BOUND], cy - solids[i, BOUND], cy + solids[i, BOUND]
            bounds[i, 0] = width / 2 + focal * (x0 / near if x0 < 0 else x0 / far) - 1
            bounds[i, 1] = width / 2 + focal * (x1 / near if x1 > 0 else x1 / far) + 1
            bounds[i, 2] = height / 2 + focal * (y0 / near if y0 < 0 else y0 / far) - 1
            bounds[i, 3] = height / 2 + focal * (y1 / near if y1 > 0 else y1 / far) + 1
    chosen = np.empty(count, np.int64)
    share = 1.0 / (samples * samples)
    for row in range(height):
        for column in range(width):
            found = 0
            for i in range(count):
                if (
                    bounds[i, 0] <= column + 1
                    and bounds[i, 1] >= column
                    and bounds[i, 2] <= row + 1
                    and bounds[i, 3] >= row
                ):
                    chosen[found] = i
                    found += 1
            dx, dy, dz = _ray(pose, focal, height, width, row + 0.5, column + 0.5)
            depth[row, column], labels[row, column] = _nearest(g, solids, chosen, found, ox, oy, oz, dx, dy, dz)
            red, green, blue = 0.0, 0.0, 0.0
            for i in range(samples):
                for j in range(samples):
                    fy, fx = (i + 0.5) / samples, (j + 0.5) / samples
                    dx, dy, dz = _ray(pose, focal, height, width, row + fy, column + fx)
                    t, label = _nearest(g, solids, chosen, found, ox, oy, oz, dx, dy, dz)
                    length = np.sqrt(dx * dx + dy * dy + dz * dz)
                    r, gr, b = _shade(
                        g,
                        solids,
                        materials,
                        volumes,
                        label,
                        (ox + t * dx, oy + t * dy, oz + t * dz),
                        (dx / length, dy / length, dz / length),
                        t * length / (focal * samples) * 1.2,
                        (2 * fx - 1, 2 * fy - 1),
                    )
                    red += r
                    green += gr
                    blue += b
            color[row, column, 0] = red * share
            color[row, column, 1] = green * share
            color[row, column, 2] = blue * share


@compiled
@no_type_check
def _ray(
    pose: np.ndarray, focal: float, height: int, width: int, row: float, column: float
) -> tuple[float, float, float]:
    """The world direction through a place of the image, of unit depth."""
    x, y = (column - width / 2) / focal, (row - height / 2) / focal
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2],
    )
