"""Compiled kernels: blend splats into rows of tiles, nearest first, and back for gradients.

The inner loops run over the 16 columns of a tile without branches, so that they compile to vector instructions. For
that, all numbers in them are of single precision, and all planes of a tile lie in one array of known shape.
"""

from math import ceil, floor
from typing import no_type_check

import numpy as np

from anystyle.renderers._compiled import compiled

Array = np.ndarray

TILE = 16
"""Side of a tile in pixels; a job is one row of tiles."""

MOMENTS = 10
"""What the gradient of a splat follows from, summed over pixels: the gradients of red, green, blue and depth; and with
the gradient ``s`` of ``sigma`` in a pixel at ``(dx, dy)`` from it, ``s, s dx, s dy, s dx², s dx dy, s dy²``."""

ZERO, ONE, HALF = np.float32(0), np.float32(1), np.float32(0.5)
MIN_ALPHA = np.float32(1 / 255)
MIN_TRANSMITTANCE = np.float32(1e-4)
LOG2_E = np.float32(1.4426950408889634)


@compiled
@no_type_check
def falloff(sigma: float) -> float:
    """``exp(-sigma)`` in single precision, exact to about two units in the last place; 0 behind 80."""
    power = -LOG2_E * min(max(sigma, ZERO), np.float32(80))
    whole = np.int32(power - HALF)
    part = power - np.float32(whole)
    # The Taylor series of 2 ** part, for part within half of 0.
    value = np.float32(1.5403530393381610e-4)
    value = value * part + np.float32(1.3333558146428443e-3)
    value = value * part + np.float32(9.6181291076284772e-3)
    value = value * part + np.float32(5.5504108664821580e-2)
    value = value * part + np.float32(2.4022650695910072e-1)
    value = value * part + np.float32(6.9314718055994531e-1)
    value = value * part + ONE
    return value * np.int32((whole + np.int32(127)) << np.int32(23)).view(np.float32)


@compiled
@no_type_check
def blend(splats: Array, lists: Array, offsets: Array, top: int, cap: float, image: Array, last: Array) -> None:
    """Blend one row of tiles.

    Args:
        splats: ``[n, SPLAT]``.
        lists: Which of them each tile may show, nearest first, one list behind the other.
        offsets: ``[columns + 1]``: where the list of each tile begins and ends.
        top: The first row of pixels.
        cap: The most that one covers of a pixel.
        image: ``[5, H, W]``, written: red, green, blue, depth and transmittance.
        last: ``[H, W]``, written: the last entry of a tile's list that a pixel was open for; -1 where there is none.
    """
    for column in range(offsets.shape[0] - 1):
        entries = lists[offsets[column] : offsets[column + 1]]
        blend_tile(splats, entries, top, column * TILE, cap, image, last)


@compiled
@no_type_check
def blend_tile(splats: Array, entries: Array, top: int, left: int, cap: float, image: Array, last: Array) -> None:
    """Blend the splats ``entries`` of one tile; see :func:`blend`."""
    tall, wide = min(TILE, last.shape[0] - top), min(TILE, last.shape[1] - left)
    # Of each pixel: red, green, blue, depth, what passes while it is open, what passes once it is full, last entry.
    tile = np.empty((TILE, 7, TILE), np.float32)
    for j in range(TILE):
        for i in range(TILE):
            for k in range(6):
                tile[j, k, i] = ZERO
            tile[j, 4, i] = ONE if (j < tall) & (i < wide) else ZERO
            tile[j, 6, i] = -ONE
    for entry in range(entries.shape[0]):
        s = splats[entries[entry]]
        place = np.float32(entry)
        x, y = np.float32(s[0] - left - 0.5), np.float32(s[1] - top - 0.5)
        first = ceil(max(float(y) - s[11] - 0.01, 0.0))
        final = floor(min(float(y) + s[11] + 0.01, tall - 1.0))
        xx, xy, yy, opacity = HALF * s[2], s[3], HALF * s[4], s[5]
        red, green, blue, depth = s[6], s[7], s[8], s[9]
        for j in range(first, final + 1):
            row = tile[j]
            dy = np.float32(j) - y
            linear, constant = xy * dy, yy * dy * dy
            for i in range(TILE):
                dx = np.float32(i) - x
                sigma = (xx * dx + linear) * dx + constant
                alpha = min(cap, opacity * falloff(sigma))
                alpha = alpha if (sigma >= ZERO) & (alpha >= MIN_ALPHA) else ZERO
                before = row[4, i]
                after = before - before * alpha
                full = after <= MIN_TRANSMITTANCE
                weight = ZERO if full else alpha * before
                row[0, i] += weight * red
                row[1, i] += weight * green
                row[2, i] += weight * blue
                row[3, i] += weight * depth
                row[5, i] += before if full else ZERO
                row[4, i] = ZERO if full else after
                row[6, i] = max(row[6, i], -ONE if full else place)
        if entry % 8 == 7:
            passing = ZERO
            for j in range(TILE):
                for i in range(TILE):
                    passing += tile[j, 4, i]
            if passing == ZERO:
                break
    for j in range(tall):
        for i in range(wide):
            for k in range(4):
                image[k, top + j, left + i] = tile[j, k, i]
            image[4, top + j, left + i] = tile[j, 4, i] + tile[j, 5, i]
            last[top + j, left + i] = int(tile[j, 6, i])


@compiled
@no_type_check
def blend_backward(
    splats: Array,
    lists: Array,
    offsets: Array,
    numbers: Array,
    starts: Array,
    top: int,
    cap: float,
    image: Array,
    last: Array,
    d_image: Array,
    moments: Array,
) -> None:
    """Sum the gradients of the splats of one row of tiles.

    Args:
        splats: ``[n, SPLAT]``.
        lists: Which of them each tile may show, nearest first, one list behind the other.
        offsets: ``[columns + 1]``: where the list of each tile begins and ends.
        numbers: The number of each entry of the lists when entries are counted splat by splat.
        starts: ``[m + 1]``: where the entries of each of the row's ``m`` splats begin and end in that count.
        top: The first row of pixels.
        cap: The most that one covers of a pixel.
        image: ``[5, H, W]``, as blended.
        last: ``[H, W]``, as blended.
        d_image: ``[5, H, W]``: the gradient of ``image``.
        moments: ``[m, MOMENTS]``, written.
    """
    # One row an entry, summed splat by splat in the end, so that no sum depends on the order of tiles.
    parts = np.zeros((lists.shape[0], MOMENTS), np.float32)
    for column in range(offsets.shape[0] - 1):
        here = slice(offsets[column], offsets[column + 1])
        blend_tile_backward(splats, lists[here], numbers[here], top, column * TILE, cap, image, last, d_image, parts)
    for i in range(moments.shape[0]):
        moments[i] = ZERO
        for number in range(starts[i], starts[i + 1]):
            for k in range(MOMENTS):
                moments[i, k] += parts[number, k]


@compiled
@no_type_check
def blend_tile_backward(
    splats: Array,
    entries: Array,
    numbers: Array,
    top: int,
    left: int,
    cap: float,
    image: Array,
    last: Array,
    d_image: Array,
    parts: Array,
) -> None:
    """Write the gradients of the splats ``entries`` of one tile to the rows ``numbers``; see :func:`blend_backward`."""
    tall, wide = min(TILE, last.shape[0] - top), min(TILE, last.shape[1] - left)
    # Of each pixel: the gradients of red, green, blue and depth, what passes, the worth of what is behind, last entry.
    tile, sums = np.empty((TILE, 7, TILE), np.float32), np.empty((7, TILE), np.float32)
    deepest = -1
    for j in range(TILE):
        for i in range(TILE):
            for k in range(6):
                tile[j, k, i] = ZERO
            tile[j, 6, i] = -ONE
    for j in range(tall):
        for i in range(wide):
            for k in range(4):
                tile[j, k, i] = d_image[k, top + j, left + i]
            tile[j, 4, i] = image[4, top + j, left + i]
            tile[j, 5, i] = d_image[4, top + j, left + i] * image[4, top + j, left + i]
            tile[j, 6, i] = last[top + j, left + i]
            deepest = max(deepest, last[top + j, left + i])
    for entry in range(deepest, -1, -1):
        s = splats[entries[entry]]
        place = np.float32(entry)
        x, y = np.float32(s[0] - left - 0.5), np.float32(s[1] - top - 0.5)
        first = ceil(max(float(y) - s[11] - 0.01, 0.0))
        final = floor(min(float(y) + s[11] + 0.01, tall - 1.0))
        xx, xy, yy, opacity = HALF * s[2], s[3], HALF * s[4], s[5]
        red, green, blue, depth = s[6], s[7], s[8], s[9]
        for k in range(7):
            for i in range(TILE):
                sums[k, i] = ZERO
        for j in range(first, final + 1):
            row = tile[j]
            dy = np.float32(j) - y
            linear, constant = xy * dy, yy * dy * dy
            for i in range(TILE):
                dx = np.float32(i) - x
                sigma = (xx * dx + linear) * dx + constant
                covered = opacity * falloff(sigma)
                alpha = min(cap, covered)
                shown = (sigma >= ZERO) & (alpha >= MIN_ALPHA) & (place <= row[6, i])
                alpha = alpha if shown else ZERO
                share = ONE / (ONE - alpha)
                before = row[4, i] * share
                weight = alpha * before
                value = red * row[0, i] + green * row[1, i] + blue * row[2, i] + depth * row[3, i]
                slope = covered * (row[5, i] * share - before * value)
                slope = slope if shown & (covered <= cap) else ZERO
                row[4, i] = before
                row[5, i] += weight * value
                sums[0, i] += weight * row[0, i]
                sums[1, i] += weight * row[1, i]
                sums[2, i] += weight * row[2, i]
                sums[3, i] += weight * row[3, i]
                sums[4, i] += slope
                sums[5, i] += slope * dy
                sums[6, i] += slope * dy * dy
        red = green = blue = depth = m0 = mx = my = mxx = mxy = myy = ZERO
        for i in range(TILE):
            dx = np.float32(i) - x
            red += sums[0, i]
            green += sums[1, i]
            blue += sums[2, i]
            depth += sums[3, i]
            m0 += sums[4, i]
            mx += sums[4, i] * dx
            my += sums[5, i]
            mxx += sums[4, i] * dx * dx
            mxy += sums[5, i] * dx
            myy += sums[6, i]
        part = parts[numbers[entry]]
        part[0], part[1], part[2], part[3], part[4] = red, green, blue, depth, m0
        part[5], part[6], part[7], part[8], part[9] = mx, my, mxx, mxy, myy
