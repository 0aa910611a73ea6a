"""Textures of procedural solids: what the surface of a point looks like under white light.

Each pattern filters itself: where it is finer than a pixel it fades to its mean, so that distant checkers do not
shimmer between views. Coordinates are in metres of the scene before it is normalised.
"""

import numpy as np

from anystyle.compiled import compiled
from anystyle_tiny.procedural import volumes as vl
from anystyle_tiny.procedural.solids import Vector
from anystyle_tiny.procedural.volumes import chance, cover, noise_at, rough, sine

TEXTURES = (
    "plain", "stripes", "checker", "dots", "bricks", "tiles", "wood", "marble", "noise", "leaves", "cells", "planks",
)  # fmt: skip
PLAIN, STRIPES, CHECKER, DOTS, BRICKS, TILES, WOOD, MARBLE, NOISE, LEAVES, CELLS, PLANKS = range(len(TEXTURES))

# Columns of a material: kind, period in metres, three colours, offset, cosine and sine of the pattern's turn,
# amplitude of the 1/f overlay, gloss.
KIND, PERIOD, COLOR_A, COLOR_B, COLOR_C, OFFSET, COSINE, SINE, ROUGH, GLOSS = 0, 1, 2, 5, 8, 11, 14, 15, 16, 17


@compiled
def _wave(x: float, footprint: float) -> float:
    """A square wave of period 1 in [-1, 1], filtered."""
    r = x - np.floor(x)
    return 2.0 * cover(0.25 - abs(r - 0.5), max(footprint, 0.01)) - 1.0


@compiled
def _blend(materials: np.ndarray, m: int, a: int, b: int, w: float, shade: float) -> Vector:
    """Between two colours of a material, times ``shade``."""
    p, q = materials[m, a : a + 3], materials[m, b : b + 3]
    v = 1 - w
    return (p[0] * v + q[0] * w) * shade, (p[1] * v + q[1] * w) * shade, (p[2] * v + q[2] * w) * shade


@compiled
def _ramp(materials: np.ndarray, m: int, t: float, shade: float) -> Vector:
    """A ramp through the three colours, ``t`` in [0, 1], times ``shade``."""
    t = min(max(t, 0.0), 1.0) * 2.0
    if t < 1:
        return _blend(materials, m, COLOR_A, COLOR_B, t, shade)
    return _blend(materials, m, COLOR_B, COLOR_C, t - 1, shade)


@compiled
def _blocks(u: float, v: float, foot: float, ratio: float, bond: float) -> tuple[float, float]:
    """Rows of blocks: how much of the pixel is joint, and a number in [0, 1) for the block."""
    row = np.floor(v)
    u = u / ratio + bond * (int(row) & 1) + (0.37 * row if bond < 0 else 0.0)
    column = np.floor(u)
    fu, fv = (u - column) * ratio, v - row
    edge = min(min(fu, ratio - fu), min(fv, 1 - fv))
    return cover(0.035 - edge, max(foot, 0.02)), chance(int(column), int(row), 3)


@compiled
def _pattern(
    materials: np.ndarray, m: int, point: Vector, u: float, v: float, foot: float, bytes_: np.ndarray
) -> Vector:
    """Colour at solid coordinates ``point`` and surface coordinates (u, v), all in periods."""
    kind, (x, y, z) = int(materials[m, KIND]), point
    if kind == STRIPES:
        wave = _wave(u + 0.12 * noise_at(bytes_, x * 0.3, y * 0.3, z * 0.3), foot)
        return _ramp(materials, m, 0.25 + 0.25 * wave, 1.0)
    if kind == CHECKER:
        return _ramp(materials, m, 0.25 + 0.25 * _wave(u * 0.5, foot) * _wave(v * 0.5, foot), 1.0)
    if kind == DOTS:
        row = np.floor(v)
        fu = u + 0.5 * (int(row) & 1)
        fu, fv = fu - np.floor(fu) - 0.5, v - row - 0.5
        return _ramp(materials, m, 0.5 * cover(0.3 - np.sqrt(fu * fu + fv * fv), max(foot, 0.02)), 1.0)
    if kind in (BRICKS, TILES, PLANKS):
        ratio, bond = (2.2, 0.5) if kind == BRICKS else (1.0, 0.0) if kind == TILES else (6.0, -0.3)
        joint, tint = _blocks(u, v, foot, ratio, bond)
        shade = 0.8 + 0.4 * tint
        if kind == PLANKS:
            shade += 0.25 * noise_at(bytes_, u * 0.5 + 7 * tint, v * 4, tint * 4)
        r, g, b = _ramp(materials, m, 0.5 * tint, shade)
        w = joint * 0.85
        c = materials[m, COLOR_C : COLOR_C + 3]
        return r * (1 - w) + c[0] * w, g * (1 - w) + c[1] * w, b * (1 - w) + c[2] * w
    if kind == WOOD:
        n = noise_at(bytes_, x * 0.25, y, z)
        rings = np.sqrt(y * y + z * z) * 1.5 + 0.6 * n + 0.1 * x
        rings -= np.floor(rings)
        grain = noise_at(bytes_, x * 0.6, y * 7, z * 7) if foot < 0.15 else 0.0
        return _ramp(materials, m, rings if foot < 0.6 else 0.5, 1.0 + 0.22 * grain)
    if kind == MARBLE:
        vein = sine(3.0 * (x + 0.6 * y) + 5.0 * rough(bytes_, x * 0.5, y * 0.5, z * 0.5, foot))
        vein = 1.0 - abs(vein)
        return _ramp(materials, m, vein * vein * vein, 1.0 + 0.1 * noise_at(bytes_, x, y, z))
    if kind in (LEAVES, CELLS):
        k = vl.LEAF_SIDE / (4.0 if kind == LEAVES else 8.0)
        side = vl.LEAF_SIDE
        at = (int(np.floor(x * k)) % side * side + int(np.floor(y * k)) % side) * side + int(np.floor(z * k)) % side
        if kind == LEAVES:
            label = int(bytes_[vl.LEAVES_AT + at])
            shade = 0.45 + 0.9 * ((label * 37) & 255) / 255.0
            return _ramp(materials, m, label / 255.0, shade * (1.0 + 0.25 * noise_at(bytes_, 2 * x, 2 * y, 2 * z)))
        shade = 1.0 - 0.6 * cover(0.7 - bytes_[vl.EDGES_AT + at] * vl.EDGE_STEP, max(foot * k, 0.8))
        return _ramp(materials, m, bytes_[vl.CELLS_AT + at] / 255.0, shade)
    if kind == NOISE:
        return _ramp(materials, m, 0.5 + 0.55 * rough(bytes_, x, y, z, foot), 1.0)
    return materials[m, COLOR_A], materials[m, COLOR_A + 1], materials[m, COLOR_A + 2]


@compiled
def albedo(
    materials: np.ndarray, m: int, point: Vector, u: float, v: float, footprint: float, bytes_: np.ndarray
) -> Vector:
    """Linear reflectance of a material."""
    (x, y, z), s = point, 1.0 / materials[m, PERIOD]
    ox, oy, oz = materials[m, OFFSET], materials[m, OFFSET + 1], materials[m, OFFSET + 2]
    tu = (u * materials[m, COSINE] - v * materials[m, SINE]) * s + ox
    tv = (u * materials[m, SINE] + v * materials[m, COSINE]) * s + oy
    r, g, b = _pattern(materials, m, (x * s + ox, y * s + oy, z * s + oz), tu, tv, footprint * s, bytes_)
    if materials[m, ROUGH] > 0:
        noise = rough(bytes_, x * 1.7 + ox, y * 1.7 + oy, z * 1.7 + oz, footprint * 1.7)
        shade = 1.0 + materials[m, ROUGH] * noise
        r, g, b = r * shade, g * shade, b * shade
    return min(max(r, 0.01), 0.95), min(max(g, 0.01), 0.95), min(max(b, 0.01), 0.95)
