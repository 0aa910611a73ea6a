"""Textures of procedural solids: what the surface of a point looks like under white light.

Each pattern filters itself: where it is finer than a pixel it fades to its mean, so that distant checkers do not
shimmer between views. Coordinates are in metres of the scene before it is normalised.
"""

from functools import cache
from typing import NamedTuple, no_type_check

import numpy as np
from numpy.typing import NDArray

from anystyle.compiled import compiled

TEXTURES = (
    "plain",
    "stripes",
    "checker",
    "dots",
    "bricks",
    "tiles",
    "wood",
    "marble",
    "noise",
    "leaves",
    "cells",
    "planks",
)
PLAIN, STRIPES, CHECKER, DOTS, BRICKS, TILES, WOOD, MARBLE, NOISE, LEAVES, CELLS, PLANKS = range(len(TEXTURES))

# Columns of a material: kind, period in metres, three colours, offset, cosine and sine of the pattern's turn,
# amplitude of the 1/f overlay, gloss.
KIND, PERIOD, COLOR_A, COLOR_B, COLOR_C, OFFSET, COSINE, SINE, ROUGH, GLOSS = 0, 1, 2, 5, 8, 11, 14, 15, 16, 17
MATERIAL_COLUMNS = 18

NOISE_SIDE = 64
LEAF_SIDE = 96
# Lattice units of noise in one period of the tile.
NOISE_UNITS = 4.0


class Tiles(NamedTuple):
    """Periodic volumes that textures look up."""

    noise: NDArray[np.float32]
    """1/f noise in about [-1, 1], NOISE_SIDE cubed."""
    leaves: NDArray[np.uint8]
    """Labels of overlapping blobs of scale-invariant sizes, as in photographs; LEAF_SIDE cubed."""
    cells: NDArray[np.uint8]
    """Labels of Voronoi cells; LEAF_SIDE cubed."""
    edges: NDArray[np.float32]
    """Distance to the border of the cell in voxels; LEAF_SIDE cubed."""


@compiled
@no_type_check
def sine(x: float) -> float:
    """The sine to 1e-7, from operations that every machine rounds alike."""
    turns = x * 0.15915494309189535
    r = turns - np.floor(turns + 0.5)
    if r > 0.25:
        r = 0.5 - r
    elif r < -0.25:
        r = -0.5 - r
    a = r * 6.283185307179586
    b = a * a
    return a * (1.0 + b * (-1.0 / 6 + b * (1.0 / 120 + b * (-1.0 / 5040 + b * (1.0 / 362880 + b * (-1.0 / 39916800))))))


@compiled
@no_type_check
def scramble(value: int) -> int:
    """Hash a small integer to 32 bits."""
    h = (value * 2654435761 + 97) & 0xFFFFFFFF
    h ^= h >> 16
    h = (h * 2246822519) & 0xFFFFFFFF
    h ^= h >> 13
    h = (h * 3266489917) & 0xFFFFFFFF
    return h ^ (h >> 16)


@compiled
@no_type_check
def _chance(x: int, y: int, z: int) -> float:
    return scramble((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) / 4294967296.0


@compiled
@no_type_check
def _make_noise(side: int) -> np.ndarray:
    tile = np.zeros((side, side, side), np.float32)
    total = 0.0
    for octave in range(4):
        cell = 16 >> octave
        cells = side // cell
        amplitude = 1.0 / (1 << octave)
        total += amplitude * 0.62
        for x in range(side):
            for y in range(side):
                for z in range(side):
                    fx, fy, fz = (x % cell) / cell, (y % cell) / cell, (z % cell) / cell
                    fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
                    value = 0.0
                    for corner in range(8):
                        i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                        weight = (fx if i else 1 - fx) * (fy if j else 1 - fy) * (fz if k else 1 - fz)
                        gx, gy, gz = (x // cell + i) % cells, (y // cell + j) % cells, (z // cell + k) % cells
                        value += weight * (2.0 * _chance(gx + 1000 * octave, gy, gz) - 1.0)
                    tile[x, y, z] += amplitude * value
    for x in range(side):
        for y in range(side):
            for z in range(side):
                tile[x, y, z] = tile[x, y, z] / total
    return tile


@compiled
@no_type_check
def _make_leaves(side: int, count: int) -> np.ndarray:
    """Dead leaves: balls and blocks dropped over each other, radii with the density of r**-3 in each slice."""
    tile = np.zeros((side, side, side), np.uint8)
    for leaf in range(count):
        # An inverse square root of a uniform number has the wanted heavy tail of sizes.
        radius = min(2.2 / np.sqrt(_chance(leaf, 1, 7) + 0.008), 22.0)
        cx, cy, cz = _chance(leaf, 2, 7) * side, _chance(leaf, 3, 7) * side, _chance(leaf, 4, 7) * side
        stretch = 0.5 + _chance(leaf, 5, 7)
        block = _chance(leaf, 6, 7) < 0.35
        reach = int(radius * max(stretch, 1.0)) + 1
        label = scramble(leaf) & 255
        for dx in range(-reach, reach + 1):
            for dy in range(-reach, reach + 1):
                for dz in range(-reach, reach + 1):
                    if block:
                        inside = max(abs(dx) / stretch, abs(dy), abs(dz) * stretch) < radius * 0.8
                    else:
                        inside = (dx / stretch) ** 2 + dy * dy + (dz * stretch) ** 2 < radius * radius
                    if inside:
                        tile[int(cx + dx) % side, int(cy + dy) % side, int(cz + dz) % side] = label
    return tile


@compiled
@no_type_check
def _make_cells(side: int, per_side: int) -> tuple[np.ndarray, np.ndarray]:
    labels = np.zeros((side, side, side), np.uint8)
    edges = np.zeros((side, side, side), np.float32)
    cell = side / per_side
    for x in range(side):
        for y in range(side):
            for z in range(side):
                bx, by, bz = int(x / cell), int(y / cell), int(z / cell)
                best, second, label = 1e9, 1e9, 0
                for i in range(-1, 2):
                    for j in range(-1, 2):
                        for k in range(-1, 2):
                            gx, gy, gz = (bx + i) % per_side, (by + j) % per_side, (bz + k) % per_side
                            px = (bx + i + _chance(gx, gy, gz + 11)) * cell - x
                            py = (by + j + _chance(gx, gy + 13, gz)) * cell - y
                            pz = (bz + k + _chance(gx + 17, gy, gz)) * cell - z
                            d = np.sqrt(px * px + py * py + pz * pz)
                            if d < best:
                                best, second = d, best
                                label = scramble(gx + per_side * (gy + per_side * gz)) & 255
                            elif d < second:
                                second = d
                labels[x, y, z] = label
                edges[x, y, z] = 0.5 * (second - best)
    return labels, edges


@cache
def tiles() -> Tiles:
    """The volumes, computed at first use and kept: they depend on nothing."""
    cells, edges = _make_cells(LEAF_SIDE, 8)
    return Tiles(_make_noise(NOISE_SIDE), _make_leaves(LEAF_SIDE, 9000), cells, edges)


@compiled
@no_type_check
def _noise_at(tile: np.ndarray, x: float, y: float, z: float) -> float:
    """Trilinear noise; a lattice unit is a quarter of the tile."""
    k = NOISE_SIDE / NOISE_UNITS
    x, y, z = x * k, y * k, z * k
    ix, iy, iz = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    fx, fy, fz = x - ix, y - iy, z - iz
    m = NOISE_SIDE - 1
    x0, y0, z0 = ix & m, iy & m, iz & m
    x1, y1, z1 = (ix + 1) & m, (iy + 1) & m, (iz + 1) & m
    a = tile[x0, y0, z0] * (1 - fz) + tile[x0, y0, z1] * fz
    b = tile[x0, y1, z0] * (1 - fz) + tile[x0, y1, z1] * fz
    c = tile[x1, y0, z0] * (1 - fz) + tile[x1, y0, z1] * fz
    d = tile[x1, y1, z0] * (1 - fz) + tile[x1, y1, z1] * fz
    return (a * (1 - fy) + b * fy) * (1 - fx) + (c * (1 - fy) + d * fy) * fx


@compiled
@no_type_check
def rough(tile: np.ndarray, x: float, y: float, z: float, footprint: float) -> float:
    """1/f noise over seven octaves in about [-1.2, 1.2]; what is finer than ``footprint`` lattice units is left out."""
    value = _noise_at(tile, x, y, z)
    if footprint < 0.12:
        value += 0.4 * _noise_at(tile, 5.3 * x + 0.37, 5.3 * y + 0.71, 5.3 * z + 0.13) * (1.0 - footprint / 0.12)
    return value


@compiled
@no_type_check
def _cover(distance: float, footprint: float) -> float:
    """How much of a pixel lies on the positive side of an edge."""
    return min(max(0.5 + distance / footprint, 0.0), 1.0)


@compiled
@no_type_check
def _wave(x: float, footprint: float) -> float:
    """A square wave of period 1 in [-1, 1], filtered."""
    r = x - np.floor(x)
    return 2.0 * _cover(0.25 - abs(r - 0.5), max(footprint, 0.01)) - 1.0


@compiled
@no_type_check
def _mix3(materials: np.ndarray, m: int, t: float, shade: float) -> tuple[float, float, float]:
    """A ramp through the three colours, ``t`` in [0, 1], times ``shade``."""
    t = min(max(t, 0.0), 1.0) * 2.0
    lo = COLOR_A if t < 1 else COLOR_B
    w = t if t < 1 else t - 1
    return (
        (materials[m, lo] * (1 - w) + materials[m, lo + 3] * w) * shade,
        (materials[m, lo + 1] * (1 - w) + materials[m, lo + 4] * w) * shade,
        (materials[m, lo + 2] * (1 - w) + materials[m, lo + 5] * w) * shade,
    )


@compiled
@no_type_check
def _laid(
    materials: np.ndarray, m: int, u: float, v: float, foot: float, ratio: float, bond: float, salt: int
) -> tuple[float, float]:
    """Rows of blocks: how much of the pixel is joint, and a number in [0, 1) for the block."""
    row = np.floor(v)
    u = u / ratio + bond * (int(row) & 1) + (0.37 * row if bond < 0 else 0.0)
    column = np.floor(u)
    fu, fv = (u - column) * ratio, v - row
    edge = min(min(fu, ratio - fu), min(fv, 1 - fv))
    return _cover(0.035 - edge, max(foot, 0.02)), _chance(int(column), int(row), salt)


@compiled
@no_type_check
def _pattern(
    materials: np.ndarray,
    m: int,
    x: float,
    y: float,
    z: float,
    u: float,
    v: float,
    foot: float,
    noise: np.ndarray,
    leaves: np.ndarray,
    cells: np.ndarray,
    edges: np.ndarray,
) -> tuple[float, float, float]:
    """Colour at solid coordinates (x, y, z) and surface coordinates (u, v), all in periods."""
    kind = int(materials[m, KIND])
    if kind == STRIPES:
        return _mix3(
            materials, m, 0.25 + 0.25 * _wave(u + 0.12 * _noise_at(noise, x * 0.3, y * 0.3, z * 0.3), foot), 1.0
        )
    if kind == CHECKER:
        return _mix3(materials, m, 0.25 + 0.25 * _wave(u * 0.5, foot) * _wave(v * 0.5, foot), 1.0)
    if kind == DOTS:
        row = np.floor(v)
        fu = u + 0.5 * (int(row) & 1)
        fu, fv = fu - np.floor(fu) - 0.5, v - row - 0.5
        return _mix3(materials, m, 0.5 * _cover(0.3 - np.sqrt(fu * fu + fv * fv), max(foot, 0.02)), 1.0)
    if kind in (BRICKS, TILES, PLANKS):
        ratio = 2.2 if kind == BRICKS else (1.0 if kind == TILES else 6.0)
        bond = 0.5 if kind == BRICKS else (0.0 if kind == TILES else -0.3)
        joint, tint = _laid(materials, m, u, v, foot, ratio, bond, 3)
        shade = 0.8 + 0.4 * tint
        if kind == PLANKS:
            shade += 0.25 * _noise_at(noise, u * 0.5 + 7 * tint, v * 4, tint * 4)
        r, g, b = _mix3(materials, m, 0.5 * tint, shade)
        w = joint * 0.85
        return (
            r * (1 - w) + materials[m, COLOR_C] * w,
            g * (1 - w) + materials[m, COLOR_C + 1] * w,
            b * (1 - w) + materials[m, COLOR_C + 2] * w,
        )
    if kind == WOOD:
        n = _noise_at(noise, x * 0.25, y, z)
        rings = np.sqrt(y * y + z * z) * 1.5 + 0.6 * n + 0.1 * x
        rings -= np.floor(rings)
        grain = _noise_at(noise, x * 0.6, y * 7, z * 7) if foot < 0.15 else 0.0
        return _mix3(materials, m, rings if foot < 0.6 else 0.5, 1.0 + 0.22 * grain)
    if kind == MARBLE:
        vein = sine(3.0 * (x + 0.6 * y) + 5.0 * rough(noise, x * 0.5, y * 0.5, z * 0.5, foot))
        vein = 1.0 - abs(vein)
        return _mix3(materials, m, vein * vein * vein, 1.0 + 0.1 * _noise_at(noise, x, y, z))
    if kind == LEAVES:
        k = LEAF_SIDE / 4.0
        i, j, h = int(np.floor(x * k)), int(np.floor(y * k)), int(np.floor(z * k))
        label = leaves[i % LEAF_SIDE, j % LEAF_SIDE, h % LEAF_SIDE]
        shade = 0.45 + 0.9 * ((label * 37) & 255) / 255.0
        return _mix3(materials, m, label / 255.0, shade * (1.0 + 0.25 * _noise_at(noise, 2 * x, 2 * y, 2 * z)))
    if kind == CELLS:
        k = LEAF_SIDE / 8.0
        i, j, h = int(np.floor(x * k)) % LEAF_SIDE, int(np.floor(y * k)) % LEAF_SIDE, int(np.floor(z * k)) % LEAF_SIDE
        shade = 1.0 - 0.6 * _cover(0.7 - edges[i, j, h], max(foot * k, 0.8))
        return _mix3(materials, m, cells[i, j, h] / 255.0, shade)
    if kind == NOISE:
        return _mix3(materials, m, 0.5 + 0.55 * rough(noise, x, y, z, foot), 1.0)
    return materials[m, COLOR_A], materials[m, COLOR_A + 1], materials[m, COLOR_A + 2]


@compiled
@no_type_check
def albedo(
    materials: np.ndarray,
    m: int,
    x: float,
    y: float,
    z: float,
    u: float,
    v: float,
    footprint: float,
    noise: np.ndarray,
    leaves: np.ndarray,
    cells: np.ndarray,
    edges: np.ndarray,
) -> tuple[float, float, float]:
    """Linear reflectance of a material.

    Args:
        materials: Rows of MATERIAL_COLUMNS numbers.
        m: Which row.
        x: Place in the solid's own axes, in metres.
        y: The second of its coordinates.
        z: The third.
        u: Place on its unrolled surface, in metres.
        v: The second of its coordinates.
        footprint: Width of a pixel there, in metres.
        noise: The volumes of :class:`Tiles`.
        leaves: The second.
        cells: The third.
        edges: The fourth.
    """
    s = 1.0 / materials[m, PERIOD]
    tu = (u * materials[m, COSINE] - v * materials[m, SINE]) * s + materials[m, OFFSET]
    tv = (u * materials[m, SINE] + v * materials[m, COSINE]) * s + materials[m, OFFSET + 1]
    px, py, pz = x * s + materials[m, OFFSET], y * s + materials[m, OFFSET + 1], z * s + materials[m, OFFSET + 2]
    r, g, b = _pattern(materials, m, px, py, pz, tu, tv, footprint * s, noise, leaves, cells, edges)
    if materials[m, ROUGH] > 0:
        shade = 1.0 + materials[m, ROUGH] * rough(
            noise,
            x * 1.7 + materials[m, OFFSET],
            y * 1.7 + materials[m, OFFSET + 1],
            z * 1.7 + materials[m, OFFSET + 2],
            footprint * 1.7,
        )
        r, g, b = r * shade, g * shade, b * shade
    return min(max(r, 0.01), 0.95), min(max(g, 0.01), 0.95), min(max(b, 0.01), 0.95)
