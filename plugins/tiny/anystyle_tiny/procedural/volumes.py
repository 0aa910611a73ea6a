"""Periodic volumes of noise, blobs and cells, and the arithmetic that makes them the same on every machine."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from anystyle.compiled import compiled

# The volumes that textures look up, one after the other in one array of bytes: 1/f noise; labels of overlapping blobs
# of scale-invariant sizes, as in photographs; labels of Voronoi cells; distance to the cell's border.
NOISE_SIDE, LEAF_SIDE = 64, 96
LEAVES_AT, CELLS_AT, EDGES_AT = (NOISE_SIDE**3 + volume * LEAF_SIDE**3 for volume in range(3))
NOISE_STEP, EDGE_STEP = 1.0 / 127.0, 1.0 / 32.0
# Lattice units of noise in one period of the tile.
NOISE_UNITS = 4.0


@compiled
def turns(y: float, x: float) -> float:
    """The angle of (x, y) in turns, in (-0.5, 0.5], continuous to 1e-3: enough to wrap a pattern around."""
    ax, ay = abs(x), abs(y)
    a = min(ax, ay) / max(max(ax, ay), 1e-12)
    s = a * a
    r = (((-0.0464964749 * s + 0.15931422) * s - 0.327622764) * s * a + a) * 0.15915494
    if ay > ax:
        r = 0.25 - r
    if x < 0:
        r = 0.5 - r
    return -r if y < 0 else r


@compiled
def sine(x: float) -> float:
    """The sine to 1e-7, from operations that every machine rounds alike."""
    turns = x * 0.15915494309189535
    r = turns - np.floor(turns + 0.5)
    if abs(r) > 0.25:
        r = (0.5 if r > 0 else -0.5) - r
    a = r * 6.283185307179586
    b = a * a
    return a * (1.0 + b * (-1.0 / 6 + b * (1.0 / 120 + b * (-1.0 / 5040 + b * (1.0 / 362880 + b * (-1.0 / 39916800))))))


@compiled
def scramble(value: int) -> int:
    """Hash a small integer to 32 bits."""
    h = (value * 2654435761 + 97) & 0xFFFFFFFF
    h = ((h ^ h >> 16) * 2246822519) & 0xFFFFFFFF
    h = ((h ^ h >> 13) * 3266489917) & 0xFFFFFFFF
    return h ^ h >> 16


@compiled
def chance(x: int, y: int, z: int) -> float:
    """Hash three integers to a number in [0, 1)."""
    return scramble((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) / 4294967296.0


@compiled
def cover(distance: float, footprint: float) -> float:
    """How much of a pixel lies on the positive side of an edge."""
    return min(max(0.5 + distance / max(footprint, 1e-6), 0.0), 1.0)


@compiled
def _make_noise(side: int) -> np.ndarray:
    tile = np.zeros((side, side, side), np.float32)
    total = 0.0
    for octave in range(4):
        cell, amplitude = 16 >> octave, 1.0 / (1 << octave)
        cells = side // cell
        total += amplitude * 0.62
        for x, y, z in np.ndindex(side, side, side):
            fx, fy, fz = (x % cell) / cell, (y % cell) / cell, (z % cell) / cell
            fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
            value = 0.0
            for i, j, k in np.ndindex(2, 2, 2):
                weight = (fx if k else 1 - fx) * (fy if j else 1 - fy) * (fz if i else 1 - fz)
                gx, gy, gz = (x // cell + k) % cells, (y // cell + j) % cells, (z // cell + i) % cells
                value += weight * (2.0 * chance(gx + 1000 * octave, gy, gz) - 1.0)
            tile[x, y, z] += amplitude * value
    return (tile / total).astype(np.float32)


@compiled
def _make_leaves(side: int, count: int) -> np.ndarray:
    """Dead leaves: balls and blocks dropped over each other, radii with the density of r**-3 in each slice."""
    tile = np.zeros((side, side, side), np.uint8)
    for leaf in range(count):
        # An inverse square root of a uniform number has the wanted heavy tail of sizes.
        radius = min(2.2 / np.sqrt(chance(leaf, 1, 7) + 0.008), 22.0)
        cx, cy, cz = chance(leaf, 2, 7) * side, chance(leaf, 3, 7) * side, chance(leaf, 4, 7) * side
        stretch = 0.5 + chance(leaf, 5, 7)
        block = chance(leaf, 6, 7) < 0.35
        reach = int(radius * max(stretch, 1.0)) + 1
        label = scramble(leaf) & 255
        for i, j, k in np.ndindex(2 * reach + 1, 2 * reach + 1, 2 * reach + 1):
            dx, dy, dz = i - reach, j - reach, k - reach
            if block:
                inside = max(abs(dx) / stretch, abs(dy), abs(dz) * stretch) < radius * 0.8
            else:
                inside = (dx / stretch) ** 2 + dy * dy + (dz * stretch) ** 2 < radius * radius
            if inside:
                tile[int(cx + dx) % side, int(cy + dy) % side, int(cz + dz) % side] = label
    return tile


@compiled
def _make_cells(side: int, per_side: int) -> tuple[np.ndarray, np.ndarray]:
    labels = np.zeros((side, side, side), np.uint8)
    edges = np.zeros((side, side, side), np.float32)
    cell = side / per_side
    for x, y, z in np.ndindex(side, side, side):
        best, second, label = 1e9, 1e9, 0
        for i, j, k in np.ndindex(3, 3, 3):
            bx, by, bz = int(x / cell) + i - 1, int(y / cell) + j - 1, int(z / cell) + k - 1
            gx, gy, gz = bx % per_side, by % per_side, bz % per_side
            px = (bx + chance(gx, gy, gz + 11)) * cell - x
            py = (by + chance(gx, gy + 13, gz)) * cell - y
            pz = (bz + chance(gx + 17, gy, gz)) * cell - z
            d = np.sqrt(px * px + py * py + pz * pz)
            if d < best:
                best, second, label = d, best, scramble(gx + per_side * (gy + per_side * gz)) & 255
            elif d < second:
                second = d
        labels[x, y, z], edges[x, y, z] = label, 0.5 * (second - best)
    return labels, edges


@cache
def volumes() -> NDArray[np.uint8]:
    """The volumes, computed at first use and kept: they depend on nothing."""
    noise = np.clip(_make_noise(NOISE_SIDE) / NOISE_STEP + 128.5, 0, 255).astype(np.uint8)
    cells, edges = _make_cells(LEAF_SIDE, 8)
    border = np.clip(edges / EDGE_STEP + 0.5, 0, 255).astype(np.uint8)
    return np.concatenate([part.ravel() for part in [noise, _make_leaves(LEAF_SIDE, 9000), cells, border]])


@compiled
def noise_at(bytes_: np.ndarray, x: float, y: float, z: float) -> float:
    """Trilinear noise in about [-1, 1]; a lattice unit is a quarter of the tile."""
    k = NOISE_SIDE / NOISE_UNITS
    x, y, z = x * k, y * k, z * k
    ix, iy, iz = np.floor(x), np.floor(y), np.floor(z)
    fx, fy, fz = x - ix, y - iy, z - iz
    m = NOISE_SIDE - 1
    x0, y0, z0 = int(ix) & m, int(iy) & m, int(iz) & m
    x1, y1, z1 = ((x0 + 1) & m) * NOISE_SIDE, ((y0 + 1) & m) * NOISE_SIDE, (z0 + 1) & m
    x0, y0 = x0 * NOISE_SIDE, y0 * NOISE_SIDE
    i, j, k, h = (x0 + 0) * NOISE_SIDE + y0, x0 * NOISE_SIDE + y1, x1 * NOISE_SIDE + y0, x1 * NOISE_SIDE + y1
    a = bytes_[i + z0] * (1 - fz) + bytes_[i + z1] * fz
    b = bytes_[j + z0] * (1 - fz) + bytes_[j + z1] * fz
    c = bytes_[k + z0] * (1 - fz) + bytes_[k + z1] * fz
    d = bytes_[h + z0] * (1 - fz) + bytes_[h + z1] * fz
    return (((a * (1 - fy) + b * fy) * (1 - fx) + (c * (1 - fy) + d * fy) * fx) - 128.0) * NOISE_STEP


@compiled
def rough(bytes_: np.ndarray, x: float, y: float, z: float, footprint: float) -> float:
    """1/f noise over seven octaves in about [-1.2, 1.2]; what is finer than ``footprint`` lattice units is left out."""
    value = noise_at(bytes_, x, y, z)
    if footprint < 0.12:
        value += 0.4 * noise_at(bytes_, 5.3 * x + 0.37, 5.3 * y + 0.71, 5.3 * z + 0.13) * (1.0 - footprint / 0.12)
    return value
