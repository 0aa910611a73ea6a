"""A ray caster for scenes of a few solids: surroundings, light, colour by supersampling, depth at pixel centres."""

import numpy as np

from anystyle.compiled import compiled
from anystyle_tiny.procedural import solids as sd
from anystyle_tiny.procedural.solids import Pair, Vector, dot, scaled
from anystyle_tiny.procedural.textures import GLOSS, albedo
from anystyle_tiny.procedural.volumes import rough

# Columns of the settings: whether it is a room, half extents of the room in x and z and its height (or the dome's
# radius), the light (direction or place, whether it is a place, radius of its disk), its colour, colours of the
# ambient from above and below, sky colours at the horizon and the zenith, cloudiness, colour and height of hills.
ROOM, EXTENT, LIGHT, NEARBY, SPREAD, SUN, ABOVE = 0, 1, 4, 7, 8, 9, 12
BELOW, HORIZON, ZENITH, CLOUDS, HILLS, HILL_HEIGHT = 15, 18, 21, 24, 25, 28
SETTING_COLUMNS = 29

WorldArrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Settings, solids, materials and the bytes of the volumes."""


@compiled
def hit_surroundings(g: np.ndarray, origin: Vector, ray: Vector) -> tuple[float, int]:
    """The floor, walls and ceiling of a room, or the ground and the dome of the sky."""
    (ox, oy, oz), (dx, dy, dz) = origin, ray
    best, label = np.inf, sd.WALL
    if dy < -1e-9:
        best, label = -oy / dy, sd.FLOOR
    if g[ROOM] > 0:
        if dy > 1e-9:
            best, label = (g[EXTENT + 1] - oy) / dy, sd.CEILING
        for extent, o, d in ((g[EXTENT], ox, dx), (g[EXTENT + 2], oz, dz)):
            if abs(d) > 1e-9:
                t = ((extent if d > 0 else -extent) - o) / d
                if t < best:
                    best, label = t, sd.WALL
        return best, label
    a, b = dot(ray, ray), dot(origin, ray)
    c = dot(origin, origin) - g[EXTENT] * g[EXTENT]
    t = (-b + np.sqrt(max(b * b - a * c, 0.0))) / a
    return (t, sd.WALL) if t < best else (best, label)


@compiled
def _mix(g: np.ndarray, first: int, a: float, second: int, b: float) -> Vector:
    """A weighted sum of two colours of the settings."""
    return g[first] * a + g[second] * b, g[first + 1] * a + g[second + 1] * b, g[first + 2] * a + g[second + 2] * b


@compiled
def _sky(g: np.ndarray, point: Vector, bytes_: np.ndarray) -> Vector:
    """Light of the dome at a point of it."""
    x, y, z = scaled(point, g[EXTENT])
    y = max(y, 0.0)
    ridge = g[HILL_HEIGHT] * (1.0 + 0.8 * rough(bytes_, x * 1.3 + 5.1, 0.5, z * 1.3, 0.01))
    if y < ridge:
        haze = 0.35 + 0.45 * y / max(ridge, 1e-6)
        shade = haze * (1.0 + 0.15 * rough(bytes_, x * 6, y * 6, z * 6, 0.01))
        return _mix(g, HILLS, shade, HORIZON, 1 - haze)
    up = np.sqrt(y)
    flat = 1.0 / (y + 0.25)
    cloud = rough(bytes_, x * flat * 0.45, 0.3, z * flat * 0.45, 0.01) + g[CLOUDS] - 0.5
    cloud = min(max(cloud * 1.6, 0.0), 0.9) * min(6 * y, 1.0)
    r, gr, b = _mix(g, HORIZON, 1 - up, ZENITH, up)
    return r * (1 - cloud) + 0.95 * cloud, gr * (1 - cloud) + 0.95 * cloud, b * (1 - cloud) + 0.97 * cloud


@compiled
def _corners(g: np.ndarray, point: Vector, normal: Vector) -> float:
    """Fraction of the ambient light that the floor and the corners of the room leave."""
    (x, y, z), (nx, ny, nz) = point, normal
    left = 1.0 - 0.45 * (0.5 - 0.5 * ny) / (1.0 + y * y * 4.0)
    if g[ROOM] > 0:
        dx, dz = g[EXTENT] - abs(x), g[EXTENT + 2] - abs(z)
        left *= 1.0 - 0.3 * (1.0 - abs(nx)) / (1.0 + dx * dx * 6.0)
        left *= 1.0 - 0.3 * (1.0 - abs(nz)) / (1.0 + dz * dz * 6.0)
    return left


@compiled
def _direct(
    g: np.ndarray, solids: np.ndarray, point: Vector, normal: Vector, view: Vector, jitter: Pair, gloss: float
) -> Pair:
    """Light of the lamp or sun at a point, and what is mirrored of it toward the camera."""
    (x, y, z), (nx, ny, nz) = point, normal
    # The light is a disk in the horizontal plane; each sub-pixel sees one fixed point of it, so that penumbras are
    # the same from everywhere.
    lx, ly, lz = g[LIGHT] + g[SPREAD] * jitter[0], g[LIGHT + 1], g[LIGHT + 2] + g[SPREAD] * jitter[1]
    if g[NEARBY] > 0:
        lx, ly, lz = lx - x, ly - y, lz - z
    squared, distance, fall = dot((lx, ly, lz), (lx, ly, lz)), 1e9, 1.0
    light = scaled((lx, ly, lz), np.sqrt(squared))
    if g[NEARBY] > 0:
        distance = np.sqrt(squared)
        fall = 2.0 * g[NEARBY] * g[NEARBY] / (g[NEARBY] * g[NEARBY] + squared)
    facing = dot(normal, light)
    if facing <= 0 or sd.shadowed(solids, (x + 1e-4 * nx, y + 1e-4 * ny, z + 1e-4 * nz), light, distance):
        return 0.0, 0.0
    mirror = 0.0
    if gloss > 0:
        between = (light[0] - view[0], light[1] - view[1], light[2] - view[2])
        half = max(dot(between, normal) / np.sqrt(max(dot(between, between), 1e-9)), 0.0)
        for _ in range(4):
            half *= half
        mirror = gloss * half * half * fall
    return facing * fall, mirror


@compiled
def shade(
    tables: WorldArrays, label: int, point: Vector, ray: Vector, footprint: float, jitter: Pair, known: float
) -> tuple[float, float, float, float]:
    """Linear light that leaves a point toward the camera, and how open the point is to ambient light."""
    (g, solids, materials, bytes_), (x, y, z) = tables, point
    if label == sd.WALL and g[ROOM] == 0:
        r, gr, b = _sky(g, point, bytes_)
        return r, gr, b, 1.0
    local, m = point, label
    if label >= sd.SOLIDS:
        normal, local, u, v = sd.surface(solids, label - sd.SOLIDS, point)
        m = int(solids[label - sd.SOLIDS, sd.PAINT])
    elif label == sd.FLOOR:
        normal, u, v = (0.0, 1.0, 0.0), x, z
    elif label == sd.CEILING:
        normal, u, v = (0.0, -1.0, 0.0), x, z
    elif g[EXTENT] - abs(x) < g[EXTENT + 2] - abs(z):
        normal, u, v = ((-1.0 if x > 0 else 1.0), 0.0, 0.0), z, y
    else:
        normal, u, v = (0.0, 0.0, (-1.0 if z > 0 else 1.0)), x, y
    if known < 0:
        known = sd.openness(solids, label, point, normal)
    grazing = max(abs(dot(normal, ray)), 0.12)
    r, gr, b = albedo(materials, m, local, u, v, footprint / grazing, bytes_)
    direct, mirror = _direct(g, solids, point, normal, ray, jitter, materials[m, GLOSS])
    ambient = known * _corners(g, point, normal)
    above, below = ambient * (0.5 + 0.5 * normal[1]), ambient * (0.5 - 0.5 * normal[1])
    r = r * (g[SUN] * direct + g[ABOVE] * above + g[BELOW] * below) + mirror * g[SUN]
    gr = gr * (g[SUN + 1] * direct + g[ABOVE + 1] * above + g[BELOW + 1] * below) + mirror * g[SUN + 1]
    b = b * (g[SUN + 2] * direct + g[ABOVE + 2] * above + g[BELOW + 2] * below) + mirror * g[SUN + 2]
    if label == sd.FLOOR and g[ROOM] == 0:
        # The ground fades into the haze where it meets the dome.
        far = (x * x + z * z) / (g[EXTENT] * g[EXTENT])
        far *= far * 0.8
        near = 1 - far
        r, gr = r * near + g[HORIZON] * far * 0.8, gr * near + g[HORIZON + 1] * far * 0.8
        b = b * near + g[HORIZON + 2] * far * 0.8
    return r, gr, b, known


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
        t = sd.hit_solid(solids, i, origin, ray, 1e-3)
        if t < best:
            best, label = t, i + sd.SOLIDS
    return best, label


@compiled
def _bounds(solids: np.ndarray, pose: np.ndarray, focal: float, height: int, width: int) -> np.ndarray:
    """Rectangles of the image that hold the solids' bounding spheres: left, right, top, bottom."""
    bounds = np.empty((len(solids), 4), np.float64)
    for i in range(len(solids)):
        v = sd.from_point(solids, i, (pose[0, 3], pose[1, 3], pose[2, 3]))
        r, cz = solids[i, sd.BOUND], pose[0, 2] * v[0] + pose[1, 2] * v[1] + pose[2, 2] * v[2]
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
    tables: WorldArrays,
    pose: np.ndarray,
    focal: float,
    color: np.ndarray,
    depth: np.ndarray,
    labels: np.ndarray,
    samples: int,
) -> None:
    """Fill ``color`` (H W 3, linear light), ``depth`` (H W, along the camera's z axis) and ``labels`` (H W)."""
    (g, solids, _, _), (height, width) = tables, depth.shape
    origin = (pose[0, 3], pose[1, 3], pose[2, 3])
    bounds = _bounds(solids, pose, focal, height, width)
    chosen = np.empty(len(solids), np.int64)
    for row in range(height):
        in_row = np.flatnonzero((bounds[:, 2] <= row + 1) & (bounds[:, 3] >= row))
        for column in range(width):
            count = 0
            for i in in_row:
                if bounds[i, 0] <= column + 1 and bounds[i, 1] >= column:
                    chosen[count] = i
                    count += 1
            ray = _ray(pose, focal, height, width, row + 0.5, column + 0.5)
            depth[row, column], labels[row, column] = _nearest(g, solids, chosen, count, origin, ray)
            red, green, blue, taken = 0.0, 0.0, 0.0, 0
            # The sd.openness to ambient light is computed once for each thing that a pixel sees.
            last, known, contrast = labels[row, column], -1.0, 0.0
            for sample in range(samples * samples):
                if sample == 2 and samples == 2 and contrast < CALM * (red + green + blue):
                    break
                # For two samples per side: one diagonal first, then the other.
                diagonal = (sample & 1, (sample & 1) ^ (sample >> 1))
                i, j = diagonal if samples == 2 else (sample // samples, sample % samples)
                fy, fx = (i + 0.5) / samples, (j + 0.5) / samples
                ray = _ray(pose, focal, height, width, row + fy, column + fx)
                t, label = _nearest(g, solids, chosen, count, origin, ray)
                length = np.sqrt(dot(ray, ray))
                point = (origin[0] + t * ray[0], origin[1] + t * ray[1], origin[2] + t * ray[2])
                view, footprint = scaled(ray, length), t * length / (focal * samples) * 1.2
                jitter, opened = (2 * fx - 1, 2 * fy - 1), known if label == last else -1.0
                r, gr, b, known = shade(tables, label, point, view, footprint, jitter, opened)
                if label != last:
                    contrast = 1e9
                elif sample == 1:
                    contrast += abs(r - red) + abs(gr - green) + abs(b - blue)
                last, taken = label, taken + 1
                red, green, blue = red + r, green + gr, blue + b
            taken = max(taken, 1)
            color[row, column] = (red / taken, green / taken, blue / taken)
