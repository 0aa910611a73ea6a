"""Procedural paintings: which colour of a palette lies at a point and how dark, and how that is painted on a sheet.

A pattern is a function of the position in periods; its edges are as soft as a pixel is wide.
"""

import numpy as np

from anystyle.compiled import compiled
from anystyle_tiny.procedural.volumes import chance, cover, noise_at, rough, sine, turns

PATTERNS = (
    "plain", "stripes", "dots", "mosaic", "checker", "bricks", "hatching", "strokes", "swirls", "waves", "zigzag",
    "splatter", "wash", "geometric", "scales", "marble", "rings", "plaid", "points", "flowers",
)  # fmt: skip
PLAIN, STRIPES, DOTS, MOSAIC, CHECKER, BRICKS, HATCHING, STROKES, SWIRLS, WAVES = range(10)
ZIGZAG, SPLATTER, WASH, GEOMETRIC, SCALES, MARBLE, RINGS, PLAID, POINTS, FLOWERS = range(10, len(PATTERNS))

# Periods on an image's side at the middle scale; finer and coarser ones are 1.7 times as many and as few.
FREQUENCY = (1.6, 7.0, 6.0, 6.0, 6.5, 5.5, 11.0, 6.0, 3.0, 5.5, 5.0, 3.4, 1.3, 3.0, 5.5, 3.2, 3.0, 3.6, 14.0, 4.0)


Blend = tuple[int, int, float, float]
"""Two colours of the palette, how far the way from the one to the other, and a shade."""


@compiled
def _cell(x: float, y: float) -> tuple[int, int, float, float]:
    """The cell of the unit grid that holds a point, and the point relative to the cell's middle."""
    i, j = np.floor(x), np.floor(y)
    return int(i), int(j), x - i - 0.5, y - j - 0.5


@compiled
def _staggered(x: float, y: float) -> tuple[int, int, float, float]:
    """Like :func:`_cell`, with every other row moved by half a cell."""
    return _cell(x + 0.5 * (int(np.floor(y)) & 1), y)


@compiled
def _pick(i: int, j: int, salt: int, count: int) -> int:
    return int(chance(i, j, salt) * count) % count


@compiled
def _bands(phase: float, foot: float, count: int) -> Blend:
    """Bands of equal width in the order of the palette; at least two."""
    band = np.floor(phase)
    f = phase - band
    k = int(band) % count
    # The edge at the upper end belongs to this band and the next one half each.
    return k, (k + 1) % count, 0.5 * cover(f - 1 + 0.5 * foot, foot), 1.0


@compiled
def _dots(x: float, y: float, foot: float, count: int, salt: int) -> Blend:
    i, j, dx, dy = _staggered(x, y)
    return 0, 1 + _pick(i, j, salt, count - 1), cover(0.32 - np.sqrt(dx * dx + dy * dy), foot), 1.0


@compiled
def _mosaic(x: float, y: float, foot: float, count: int, salt: int) -> Blend:
    ix, iy = int(np.floor(x)), int(np.floor(y))
    best, second, ci, cj = 1e9, 1e9, 0, 0
    for di, dj in np.ndindex(3, 3):
        i, j = ix + di - 1, iy + dj - 1
        dx, dy = i + 0.15 + 0.7 * chance(i, j, salt) - x, j + 0.15 + 0.7 * chance(i, j, salt + 1) - y
        d = np.sqrt(dx * dx + dy * dy)
        if d < best:
            best, second, ci, cj = d, best, i, j
        elif d < second:
            second = d
    k = _pick(ci, cj, salt + 2, count)
    joint = cover(0.07 - 0.5 * (second - best), foot)
    shade = (0.82 + 0.36 * chance(ci, cj, salt + 3)) * (1.0 - 0.8 * joint)
    return k, k, 0.0, shade


@compiled
def _bricks(x: float, y: float, foot: float, count: int, salt: int) -> Blend:
    row = np.floor(y)
    u = x * 0.5 + 0.5 * (int(row) & 1)
    column = np.floor(u)
    fu, fv = (u - column) * 2.0, y - row
    edge = min(min(fu, 2.0 - fu), min(fv, 1.0 - fv))
    k = 1 + _pick(int(column), int(row), salt, count - 1)
    shade = 0.8 + 0.3 * chance(int(column), int(row), salt + 1)
    return k, 0, cover(0.09 - edge, foot), shade


@compiled
def _hatching(x: float, y: float, foot: float, count: int, salt: int, noise: np.ndarray) -> Blend:
    tone = noise_at(noise, x * 0.09 + salt, y * 0.09, 0.37) + 0.15
    wobble = 0.35 * noise_at(noise, x * 0.2, y * 0.2, 1.7 + salt)
    f = y + wobble
    f = f - np.floor(f)
    line = cover(0.17 + 0.06 * tone - abs(f - 0.5), foot)
    k = 1 + _pick(int(np.floor(y + wobble)), 0, salt, count - 1)
    if tone > -0.05:
        g = x * 0.95 + 0.3 * y + wobble
        g = g - np.floor(g)
        line = max(line, cover(0.16 - abs(g - 0.5), foot) * min(max((tone + 0.05) * 8, 0.0), 1.0))
    return 0, k, line, 1.0


@compiled
def _strokes(x: float, y: float, foot: float, count: int, salt: int, noise: np.ndarray) -> Blend:
    """Dabs of paint along a slowly turning field, three layers deep."""
    ix, iy = int(np.floor(x)), int(np.floor(y))
    best, color, shade = -1.0, 0, 0.7
    for layer in range(2):
        for di, dj in np.ndindex(3, 3):
            i, j = ix + di - 1, iy + dj - 1
            s = salt + 17 * layer
            rank = chance(i, j, s) + layer
            if rank <= best:
                continue
            cx, cy = i + chance(i, j, s + 1), j + chance(i, j, s + 2)
            if (x - cx) * (x - cx) + (y - cy) * (y - cy) > 0.9025:
                continue
            turn = 1.6 * noise_at(noise, cx * 0.11 + salt, cy * 0.11, 0.5) + 0.12 * chance(i, j, s + 3)
            c, d = sine(6.2831853 * turn + 1.5707963), sine(6.2831853 * turn)
            u, v = c * (x - cx) + d * (y - cy), c * (y - cy) - d * (x - cx)
            long_, wide = 0.95, 0.24 + 0.12 * chance(i, j, s + 4)
            inside = 1.0 - (u * u) / (long_ * long_) - (v * v) / (wide * wide)
            if inside > 0:
                best, color = rank, _pick(i, j, s + 5, count)
                bristle = noise_at(noise, u * 0.25 + i, v * 3.0 + j, 0.9)
                shade = 0.86 + 0.26 * chance(i, j, s + 6) + 0.3 * bristle + 0.45 * v
                shade *= 0.75 + 0.25 * min(inside * 3.0, 1.0)
    return color, color, 0.0, shade


@compiled
def _swirls(x: float, y: float, foot: float, count: int, salt: int, noise: np.ndarray) -> Blend:
    """Strokes that curl around vortices."""
    x += 0.35 * noise_at(noise, x * 0.4 + salt, y * 0.4, 0.1)
    y += 0.35 * noise_at(noise, x * 0.4 + salt, y * 0.4, 2.1)
    ix, iy = int(np.floor(x)), int(np.floor(y))
    best, rx, ry, ci, cj = 1e9, 0.0, 0.0, 0, 0
    for di, dj in np.ndindex(3, 3):
        i, j = ix + di - 1, iy + dj - 1
        dx, dy = x - i - 0.2 - 0.6 * chance(i, j, salt), y - j - 0.2 - 0.6 * chance(i, j, salt + 1)
        d = dx * dx + dy * dy
        if d < best:
            best, rx, ry, ci, cj = d, dx, dy, i, j
    r = np.sqrt(best)
    spin = 1.0 if chance(ci, cj, salt + 2) < 0.5 else -1.0
    phase = r * 5.0 + spin * turns(ry, rx) * 2.0 * ((count + 1) // 2)
    band = np.floor(phase)
    k = int(band + 64 * count) % count
    f = phase - band
    shade = 0.8 + 0.28 * (1.0 - abs(2.0 * f - 1.0)) + 0.25 * noise_at(noise, phase * 0.9, r * 2.0, 0.3 * ci)
    return k, k, 0.0, shade


@compiled
def _splatter(x: float, y: float, foot: float, count: int, salt: int, noise: np.ndarray) -> Blend:
    """Drops of all sizes thrown on the first colour."""
    color, most = 0, 0.0
    for level in range(3):
        s = 1.0 + 1.2 * level * level
        px, py = x * s, y * s
        ix, iy = int(np.floor(px)), int(np.floor(py))
        for di, dj in np.ndindex(3, 3):
            i, j = ix + di - 1, iy + dj - 1
            if chance(i, j, salt + level) > 0.7:
                continue
            dx, dy = px - i - chance(i, j, salt + 11 + level), py - j - chance(i, j, salt + 23 + level)
            d = np.sqrt(dx * dx + dy * dy)
            size = chance(i, j, salt + 31 + level)
            radius = 0.16 + 0.3 * size * size
            if d > 1.3 * radius + foot * s:
                continue
            angle = turns(dy, dx)
            lobes = 0.12 * sine(6.2831853 * (angle * (5 + _pick(i, j, salt, 4)) + chance(i, j, salt + 5)))
            lobes += 0.06 * sine(6.2831853 * (angle * 11 + chance(i, j, salt + 6)))
            hit = cover(radius * (1 + 1.6 * lobes) - d, foot * s)
            if hit > most:
                most, color = hit, 1 + _pick(i, j, salt + 41 + level, count - 1)
    return 0, color, most, 1.0


@compiled
def _geometric(x: float, y: float, foot: float, count: int, salt: int) -> Blend:
    """Triangles, bars and disks over each other, each of one flat colour."""
    ix, iy = int(np.floor(x)), int(np.floor(y))
    best, color, shade = -1.0, 0, 0.9
    for di, dj in np.ndindex(3, 3):
        i, j = ix + di - 1, iy + dj - 1
        for k in range(2):
            s = salt + 13 * k
            rank = chance(i, j, s)
            if rank <= best:
                continue
            dx, dy = x - i - chance(i, j, s + 1), y - j - chance(i, j, s + 2)
            turn = 6.2831853 * chance(i, j, s + 3)
            c, d = sine(turn + 1.5707963), sine(turn)
            u, v = c * dx + d * dy, c * dy - d * dx
            kind = _pick(i, j, s + 4, 3)
            if kind == 0:
                inside = max(max(u * 0.866 + v * 0.5, -u * 0.866 + v * 0.5), -v) < 0.3
            elif kind == 1:
                inside = abs(u) < 0.75 and abs(v) < 0.22
            else:
                inside = u * u + v * v < 0.2
            if inside:
                best, color = rank, _pick(i, j, s + 5, count)
                shade = 0.8 + 0.35 * chance(i, j, s + 6)
    return color, color, 0.0, shade


@compiled
def _scales(x: float, y: float, foot: float, count: int, salt: int) -> Blend:
    """Overlapping half disks in rows."""
    for step in range(2, -1, -1):
        row = int(np.floor(2.0 * y)) + step
        u = x + 0.5 * (row & 1)
        column = int(np.floor(u))
        dx, dy = u - column - 0.5, y - 0.5 * row + 0.5
        d = np.sqrt(dx * dx + dy * dy)
        if step == 0 or d < 0.52:
            k = _pick(column, row, salt, count)
            rim = cover(d - 0.45, foot)
            return k, k, 0.0, (0.85 + 0.25 * chance(column, row, salt + 1)) * (1.0 - 0.65 * rim) * (1.15 - 0.5 * d)
    return 0, 0, 0.0, 1.0


@compiled
def _flowers(x: float, y: float, foot: float, count: int, salt: int) -> Blend:
    i, j, dx, dy = _staggered(x, y)
    dx, dy = dx + 0.1 * (chance(i, j, salt) - 0.5), dy + 0.1 * (chance(i, j, salt + 1) - 0.5)
    d = np.sqrt(dx * dx + dy * dy)
    petals = 5 + _pick(i, j, salt + 2, 3)
    radius = 0.33 + 0.12 * sine(6.2831853 * (petals * turns(dy, dx) + chance(i, j, salt + 3)))
    k = 1 + _pick(i, j, salt + 4, count - 1)
    heart = (k % (count - 1)) + 1 if count > 2 else 0
    if d < 0.13:
        return k, heart, cover(0.1 - d, foot), 0.95
    return 0, k, cover(radius - d, foot), 1.0 if d > radius else 0.8 + 0.6 * d


@compiled
def _wash(x: float, y: float, count: int, salt: int, noise: np.ndarray) -> Blend:
    """Colours that run into each other."""
    t = 0.55 * y + 0.9 * rough(noise, x * 0.35 + 0.1 * salt, y * 0.35, 0.2, 1.0) + 0.5
    t = min(max(t * 0.75, 0.0), 0.9999) * (count - 1)
    k = int(t)
    f = t - k
    return k, k + 1, f * f * (3 - 2 * f), 1.0


@compiled
def pattern_at(kind: int, x: float, y: float, foot: float, count: int, salt: int, noise: np.ndarray) -> Blend:
    """Two colours of the palette, the mixture between them and a shade, at a place in periods."""
    if kind == PLAIN:
        t = y * 0.7 * count * 0.5 + 0.06 * rough(noise, x + salt, y, 0.3, 1.0)
        return _bands(t, max(foot, 0.12), count)
    if kind == STRIPES:
        return _bands(y * 2.0, 2.0 * foot, count)
    if kind == DOTS:
        return _dots(x, y, foot, count, salt)
    if kind == MOSAIC:
        return _mosaic(x, y, foot, count, salt)
    if kind == CHECKER:
        i, j = int(np.floor(x)), int(np.floor(y))
        k = (i + j) % 2
        if k == 1 and count > 2:
            k = 1 + _pick(i, j, salt, count - 1)
        return k, k, 0.0, 1.0
    if kind == BRICKS:
        return _bricks(x, y, foot, count, salt)
    if kind == HATCHING:
        return _hatching(x, y, foot, count, salt, noise)
    if kind == STROKES:
        return _strokes(x, y, foot, count, salt, noise)
    if kind == SWIRLS:
        return _swirls(x, y, foot, count, salt, noise)
    if kind == WAVES:
        return _bands(2.0 * y + 0.9 * sine(x * 2.9), 2.4 * foot, count)
    if kind == ZIGZAG:
        f = x * 0.9 - np.floor(x * 0.9)
        return _bands(2.0 * y + 1.6 * abs(f - 0.5), 2.6 * foot, count)
    if kind == SPLATTER:
        return _splatter(x, y, foot, count, salt, noise)
    if kind == WASH:
        return _wash(x, y, count, salt, noise)
    if kind == GEOMETRIC:
        return _geometric(x, y, foot, count, salt)
    if kind == SCALES:
        return _scales(x, y, foot, count, salt)
    if kind == MARBLE:
        wx = x + 0.9 * rough(noise, x * 0.4 + salt, y * 0.4, 0.1, 0.05)
        wy = y + 0.9 * rough(noise, x * 0.4 + salt, y * 0.4, 2.3, 0.05)
        return _bands(5.0 * noise_at(noise, wx * 0.5, wy * 0.5, 0.1 * salt) + 1.4 * wy + 16.0, 5.0 * foot, count)
    if kind == RINGS:
        i, j, dx, dy = _cell(x, y)
        return _bands(np.sqrt(dx * dx + dy * dy) * 7.0 + _pick(i, j, salt, count), 7.0 * foot, count)
    if kind == PLAID:
        a, b, m, _ = _bands(x * 2.0, 2.0 * foot, count)
        c, d, n, _ = _bands(y * 2.0, 2.0 * foot, count)
        # Threads of the two directions lie over each other in turn.
        over = int(np.floor(x * 24.0) + np.floor(y * 24.0)) & 1
        thin = cover(0.06 - abs(x - np.floor(x) - 0.25), foot) + cover(0.06 - abs(y - np.floor(y) - 0.25), foot)
        shade = 1.0 - 0.35 * min(thin, 1.0)
        return (a, b, m, shade) if over else (c, d, n, shade)
    if kind == POINTS:
        i, j, dx, dy = _cell(x, y)
        dx, dy = dx - 0.3 * (chance(i, j, salt) - 0.5), dy - 0.3 * (chance(i, j, salt + 1) - 0.5)
        k = _pick(i, j, salt + 2, count)
        dot = cover(0.42 - np.sqrt(dx * dx + dy * dy), foot)
        return k, k, 0.0, 0.62 + dot * (0.3 + 0.25 * chance(i, j, salt + 3))
    return _flowers(x, y, foot, count, salt)


BRUSHWORK = ("print", "oil", "watercolour", "chalk")
PRINT, OIL, WATERCOLOUR, CHALK = range(len(BRUSHWORK))


@compiled
def _brushed(brush: int, u: float, v: float, bytes_: np.ndarray) -> tuple[float, float]:
    """How a way of painting changes a place of the sheet: a factor, and how much of the paper shows."""
    if brush == OIL:
        along, across = 0.8 * u + 0.5 * v, 6.0 * v - 2.4 * u
        streak = noise_at(bytes_, along, across, 0.6 + 0.31 * u)
        return 1.0 + 0.64 * streak - 0.5 * noise_at(bytes_, along, across - 0.12, 0.6 + 0.31 * u), 0.0
    if brush == WATERCOLOUR:
        wet = rough(bytes_, 0.8 * u, 0.8 * v, 1.1, 0.0)
        return 1.0, min(max(0.16 + 0.3 * wet, 0.0), 0.45)
    # The grain lies in a slanted plane of the volume, so that its period is not seen.
    grain = noise_at(bytes_, 6.1 * u + 1.3 * v, 5.7 * v - 1.9 * u, 2.3 * u + 3.1 * v)
    if brush == CHALK:
        return 1.0, min(max(1.2 * (grain - 0.05), 0.0), 0.5)
    return 1.0 + 0.03 * grain, 0.0


@compiled
def paint(
    kind: int,
    brush: int,
    frequency: float,
    turn: np.ndarray,
    offset: np.ndarray,
    palette: np.ndarray,
    salt: int,
    bytes_: np.ndarray,
    image: np.ndarray,
) -> None:
    """Fill ``image`` (H W 3, sRGB in [0, 1]) with a pattern in a palette, painted in one of BRUSHWORK."""
    height, width = image.shape[0], image.shape[1]
    count = len(palette)
    foot = 0.7 * frequency / height
    hand = 0.0 if brush == PRINT else 0.11
    for row in range(height):
        for column in range(width):
            red, green, blue, taken, contrast = 0.0, 0.0, 0.0, 0, 0.0
            for sample in range(4):
                # One diagonal of the pixel first; where it is calm, the other one is not needed.
                if sample == 2 and contrast < 0.06:
                    break
                i, j = sample & 1, (sample & 1) ^ (sample >> 1)
                # Place on the sheet, the height being 4 lattice units of noise.
                u, v = 4.0 * (column + 0.25 + 0.5 * j) / height, 4.0 * (row + 0.25 + 0.5 * i) / height
                px, py = (u - 2.0) * frequency * 0.25, (v - 2.0) * frequency * 0.25
                px, py = turn[0] * px - turn[1] * py + offset[0], turn[1] * px + turn[0] * py + offset[1]
                u, v = u + 0.37 * salt, v + 0.61 * salt
                if hand > 0:
                    px += hand * noise_at(bytes_, 0.9 * u, 0.9 * v, 0.2)
                    py += hand * noise_at(bytes_, 0.9 * u, 0.9 * v, 2.2)
                a, b, m, shade = pattern_at(kind, px, py, foot, count, salt, bytes_)
                dark, pale = _brushed(brush, u, v, bytes_)
                shade *= dark * (1 - pale)
                r = (palette[a, 0] * (1 - m) + palette[b, 0] * m) * shade + 0.97 * pale
                g = (palette[a, 1] * (1 - m) + palette[b, 1] * m) * shade + 0.96 * pale
                c = (palette[a, 2] * (1 - m) + palette[b, 2] * m) * shade + 0.93 * pale
                if sample == 1:
                    contrast = abs(r - red) + abs(g - green) + abs(c - blue)
                red, green, blue, taken = red + r, green + g, blue + c, taken + 1
            image[row, column, 0] = min(max(red / taken, 0.0), 1.0)
            image[row, column, 1] = min(max(green / taken, 0.0), 1.0)
            image[row, column, 2] = min(max(blue / taken, 0.0), 1.0)
