"""How a procedural scene is lit: its surroundings, sky, lamp and sun, and the light that leaves a point of it."""

import numpy as np

from anystyle.compiled import compiled
from anystyle_tiny.procedural.solids import CEILING, FLOOR, PAINT, SOLIDS, WALL, openness, shadowed, surface
from anystyle_tiny.procedural.textures import GLOSS, albedo
from anystyle_tiny.procedural.volumes import rough

# Columns of the settings: whether it is a room, half extents of the room in x and z and its height (or the dome's
# radius), the light (direction or place, whether it is a place, radius of its disk), its colour, colours of the
# ambient from above and below, sky colours at the horizon and the zenith, cloudiness, colour and height of hills.
ROOM, EXTENT, LIGHT, NEARBY, SPREAD, SUN, ABOVE = 0, 1, 4, 7, 8, 9, 12
BELOW, HORIZON, ZENITH, CLOUDS, HILLS, HILL_HEIGHT = 15, 18, 21, 24, 25, 28
SETTING_COLUMNS = 29


@compiled
def hit_surroundings(
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
def _sky(g: np.ndarray, x: float, y: float, z: float, bytes_: np.ndarray) -> tuple[float, float, float]:
    """Light of the dome at a point of it."""
    r = g[EXTENT]
    x, y, z = x / r, max(y / r, 0.0), z / r
    ridge = g[HILL_HEIGHT] * (1.0 + 0.8 * rough(bytes_, x * 1.3 + 5.1, 0.5, z * 1.3, 0.01))
    if y < ridge:
        haze = 0.35 + 0.45 * y / max(ridge, 1e-6)
        shade = haze * (1.0 + 0.15 * rough(bytes_, x * 6, y * 6, z * 6, 0.01))
        return (
            g[HILLS] * shade + g[HORIZON] * (1 - haze),
            g[HILLS + 1] * shade + g[HORIZON + 1] * (1 - haze),
            g[HILLS + 2] * shade + g[HORIZON + 2] * (1 - haze),
        )
    up = np.sqrt(y)
    flat = 1.0 / (y + 0.25)
    cloud = rough(bytes_, x * flat * 0.45, 0.3, z * flat * 0.45, 0.01) + g[CLOUDS] - 0.5
    cloud = min(max(cloud * 1.6, 0.0), 0.9) * min(6 * y, 1.0)
    return (
        (g[HORIZON] * (1 - up) + g[ZENITH] * up) * (1 - cloud) + 0.95 * cloud,
        (g[HORIZON + 1] * (1 - up) + g[ZENITH + 1] * up) * (1 - cloud) + 0.95 * cloud,
        (g[HORIZON + 2] * (1 - up) + g[ZENITH + 2] * up) * (1 - cloud) + 0.97 * cloud,
    )


@compiled
def _corners(g: np.ndarray, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Share of the ambient light that the floor and the corners of the room leave."""
    left = 1.0 - 0.45 * (0.5 - 0.5 * ny) / (1.0 + y * y * 4.0)
    if g[ROOM] > 0:
        dx, dz = g[EXTENT] - abs(x), g[EXTENT + 2] - abs(z)
        left *= 1.0 - 0.3 * (1.0 - abs(nx)) / (1.0 + dx * dx * 6.0)
        left *= 1.0 - 0.3 * (1.0 - abs(nz)) / (1.0 + dz * dz * 6.0)
    return left


@compiled
def _direct(
    g: np.ndarray,
    solids: np.ndarray,
    point: tuple[float, float, float],
    normal: tuple[float, float, float],
    view: tuple[float, float, float],
    jitter: tuple[float, float],
    gloss: float,
) -> tuple[float, float]:
    """Light of the lamp or sun at a point, and what is mirrored of it toward the camera."""
    x, y, z = point
    nx, ny, nz = normal
    lx, ly, lz, reach, fall = g[LIGHT], g[LIGHT + 1], g[LIGHT + 2], 1e9, 1.0
    # The light is a disk in the horizontal plane; each sub-pixel sees one fixed point of it, so that penumbras are
    # the same from everywhere.
    lx, lz = lx + g[SPREAD] * jitter[0], lz + g[SPREAD] * jitter[1]
    if g[NEARBY] > 0:
        lx, ly, lz = lx - x, ly - y, lz - z
    squared = lx * lx + ly * ly + lz * lz
    length = np.sqrt(squared)
    lx, ly, lz = lx / length, ly / length, lz / length
    if g[NEARBY] > 0:
        reach = length
        fall = 2.0 * g[NEARBY] * g[NEARBY] / (g[NEARBY] * g[NEARBY] + squared)
    facing = nx * lx + ny * ly + nz * lz
    if facing <= 0 or shadowed(solids, x + 1e-4 * nx, y + 1e-4 * ny, z + 1e-4 * nz, lx, ly, lz, reach):
        return 0.0, 0.0
    mirror = 0.0
    if gloss > 0:
        hx, hy, hz = lx - view[0], ly - view[1], lz - view[2]
        half = (hx * nx + hy * ny + hz * nz) / np.sqrt(max(hx * hx + hy * hy + hz * hz, 1e-9))
        half = max(half, 0.0)
        for _ in range(4):
            half *= half
        mirror = gloss * half * half * fall
    return facing * fall, mirror


@compiled
def shade(
    g: np.ndarray,
    solids: np.ndarray,
    materials: np.ndarray,
    bytes_: np.ndarray,
    label: int,
    point: tuple[float, float, float],
    ray: tuple[float, float, float],
    footprint: float,
    jitter: tuple[float, float],
    known: float,
) -> tuple[float, float, float, float]:
    """Linear light that leaves a point toward the camera, and how open the point is to ambient light.

    Args:
        g: Settings of the scene.
        solids: A row a solid.
        materials: A row a material.
        bytes_: The volumes of textures.
        label: What the point lies on.
        point: The point.
        ray: Unit vector of the way it is seen along.
        footprint: Width of a sub-pixel there, for a surface that faces the camera.
        jitter: Point of the light's disk, in [-1, 1].
        known: The openness if it is known already, else a negative number.
    """
    x, y, z = point
    if label == WALL and g[ROOM] == 0:
        r, gr, b = _sky(g, x, y, z, bytes_)
        return r, gr, b, 1.0
    lx, ly, lz = x, y, z
    if label >= SOLIDS:
        nx, ny, nz, lx, ly, lz, u, v = surface(solids, label - SOLIDS, x, y, z)
        m = int(solids[label - SOLIDS, PAINT])
    elif label == FLOOR:
        nx, ny, nz, u, v, m = 0.0, 1.0, 0.0, x, z, FLOOR
    elif label == CEILING:
        nx, ny, nz, u, v, m = 0.0, -1.0, 0.0, x, z, CEILING
    elif g[EXTENT] - abs(x) < g[EXTENT + 2] - abs(z):
        nx, ny, nz, u, v, m = (-1.0 if x > 0 else 1.0), 0.0, 0.0, z, y, WALL
    else:
        nx, ny, nz, u, v, m = 0.0, 0.0, (-1.0 if z > 0 else 1.0), x, y, WALL
    if known < 0:
        known = openness(solids, label, x, y, z, nx, ny, nz)
    grazing = max(abs(nx * ray[0] + ny * ray[1] + nz * ray[2]), 0.12)
    r, gr, b = albedo(materials, m, lx, ly, lz, u, v, footprint / grazing, bytes_)
    direct, mirror = _direct(g, solids, point, (nx, ny, nz), ray, jitter, materials[m, GLOSS])
    ambient = known * _corners(g, x, y, z, nx, ny, nz)
    above, below = ambient * (0.5 + 0.5 * ny), ambient * (0.5 - 0.5 * ny)
    r = r * (g[SUN] * direct + g[ABOVE] * above + g[BELOW] * below) + mirror * g[SUN]
    gr = gr * (g[SUN + 1] * direct + g[ABOVE + 1] * above + g[BELOW + 1] * below) + mirror * g[SUN + 1]
    b = b * (g[SUN + 2] * direct + g[ABOVE + 2] * above + g[BELOW + 2] * below) + mirror * g[SUN + 2]
    if label == FLOOR and g[ROOM] == 0:
        # The ground fades into the haze where it meets the dome.
        far = (x * x + z * z) / (g[EXTENT] * g[EXTENT])
        far *= far * 0.8
        r, gr, b = (
            r * (1 - far) + g[HORIZON] * far * 0.8,
            gr * (1 - far) + g[HORIZON + 1] * far * 0.8,
            b * (1 - far) + g[HORIZON + 2] * far * 0.8,
        )
    return r, gr, b, known
