"""Painting a pattern on a sheet: brushwork, paper and anti-aliasing."""

import numpy as np

from anystyle.compiled import compiled
from anystyle_tiny.procedural.patterns import pattern_at
from anystyle_tiny.procedural.volumes import noise_at, rough

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
