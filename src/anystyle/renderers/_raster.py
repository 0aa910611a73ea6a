"""Compiled kernels: blend splats into rows of tiles, nearest first, and back for gradients."""

from math import ceil, exp, floor, sqrt
from typing import no_type_check

import numpy as np

from anystyle.renderers._compiled import compiled

Array = np.ndarray

TILE = 16
"""Side of a tile in pixels; a job is one row of tiles."""

MOMENTS = 10
"""What a splat's gradient is summed from, over pixels: the gradients of red, green, blue and depth; and, with ``s``
the gradient of ``sigma`` in a pixel at ``(dx, dy)`` from the splat, the sums of ``s, s dx, s dy, s dx², s dx dy,
s dy²``."""


@compiled
@no_type_check
def rows_of(splats: Array, height: int, offsets: Array) -> Array:
    """List the splats of every row of tiles, in the order of ``splats``.

    Args:
        splats: ``[n, SPLAT]``, nearest first.
        height: In pixels.
        offsets: ``[rows + 1]``, written: where the list of each row begins and ends.

    Returns:
        The lists, one behind the other.
    """
    rows = offsets.shape[0] - 1
    offsets[:] = 0
    for i in range(splats.shape[0]):
        first, last = row_span(splats[i], rows)
        for row in range(first, last + 1):
            offsets[row + 1] += 1
    for row in range(rows):
        offsets[row + 1] += offsets[row]
    cursor = offsets[:-1].copy()
    lists = np.empty(offsets[rows], np.int32)
    for i in range(splats.shape[0]):
        first, last = row_span(splats[i], rows)
        for row in range(first, last + 1):
            lists[cursor[row]] = i
            cursor[row] += 1
    return lists


@compiled
@no_type_check
def row_span(splat: Array, rows: int) -> tuple[int, int]:
    """The first and the last row of tiles that a splat may reach."""
    first = max((float(splat[1]) - splat[11] - 1.0) / TILE, 0.0)
    last = min((float(splat[1]) + splat[11] + 1.0) / TILE, rows - 1.0)
    return int(first), int(last)


@compiled
@no_type_check
def tile_span(splat: Array, columns: int) -> tuple[int, int]:
    """The first and the last tile of a row that a splat may reach."""
    # The half width follows from the half height: their squares are as the variances, and these as the conic's.
    wide = splat[11] * sqrt(float(splat[4]) / float(splat[2]))
    first = max((float(splat[0]) - wide - 1.0) / TILE, 0.0)
    last = min((float(splat[0]) + wide + 1.0) / TILE, columns - 1.0)
    return int(first), int(last)


@compiled
@no_type_check
def tiles_of(splats: Array, members: Array, columns: int, offsets: Array) -> tuple[Array, Array]:
    """Sort the splats of a row of tiles into its tiles.

    Args:
        splats: ``[n, SPLAT]``, nearest first.
        members: ``[m]``: which of them are in the row.
        columns: How many tiles the row has.
        offsets: ``[columns + 1]``, written: where the list of each tile begins and ends.

    Returns:
        The lists of places in ``members``, and for each entry its number when counted member by member.
    """
    offsets[:] = 0
    for i in range(members.shape[0]):
        first, last = tile_span(splats[members[i]], columns)
        for column in range(first, last + 1):
            offsets[column + 1] += 1
    for column in range(columns):
        offsets[column + 1] += offsets[column]
    cursor = offsets[:-1].copy()
    lists = np.empty(offsets[columns], np.int32)
    numbers = np.empty(offsets[columns], np.int32)
    number = 0
    for i in range(members.shape[0]):
        first, last = tile_span(splats[members[i]], columns)
        for column in range(first, last + 1):
            lists[cursor[column]] = i
            numbers[cursor[column]] = number
            cursor[column] += 1
            number += 1
    return lists, numbers


@compiled
@no_type_check
def row_interval(splat: Array, dy: float, left: int, width: int) -> tuple[int, int]:
    """The columns of a row of pixels, from ``left`` on, that a splat at ``dy`` from the row reaches."""
    xx, xy, yy = float(splat[2]), float(splat[3]), float(splat[4])
    discriminant = 2.0 * splat[10] * xx - dy * dy * (xx * yy - xy * xy)
    if not discriminant >= 0.0:
        return 0, -1
    half = sqrt(discriminant) / xx
    center = splat[0] - xy * dy / xx - 0.5 - left
    # A little wider than exact, against rounding; the threshold on alpha decides.
    first = max(center - half - 0.01, 0.0)
    last = min(center + half + 0.01, width - 1.0)
    return ceil(first), floor(last)


@compiled
@no_type_check
def blend(splats: Array, members: Array, top: int, cap: float, image: Array, last: Array) -> None:
    """Blend one row of tiles.

    Args:
        splats: ``[n, SPLAT]``, nearest first.
        members: ``[m]``: which of them are in the row.
        top: The first row of pixels.
        cap: The most a splat covers of a pixel.
        image: ``[5, H, W]``, written: red, green, blue, depth and transmittance.
        last: ``[H, W]``, written: the last of ``members`` that contributes to a pixel, -1 where none does.
    """
    height, width = last.shape
    columns = (width + TILE - 1) // TILE
    tall = min(TILE, height - top)
    offsets = np.empty(columns + 1, np.int64)
    lists, _ = tiles_of(splats, members, columns, offsets)
    for column in range(columns):
        left = column * TILE
        wide = min(TILE, width - left)
        image[:4, top : top + tall, left : left + wide] = 0.0
        image[4, top : top + tall, left : left + wide] = 1.0
        last[top : top + tall, left : left + wide] = -1
        full = np.zeros((TILE, TILE), np.bool_)
        open_pixels = tall * wide
        for entry in range(offsets[column], offsets[column + 1]):
            if open_pixels == 0:
                break
            place = lists[entry]
            s = splats[members[place]]
            reach = s[11]
            first_row = int(max(ceil(s[1] - reach - 0.51 - top), 0.0))
            last_row = int(min(floor(s[1] + reach - 0.49 - top), tall - 1.0))
            for j in range(first_row, last_row + 1):
                dy = top + j + 0.5 - float(s[1])
                first, final = row_interval(s, dy, left, wide)
                for i in range(first, final + 1):
                    if full[j, i]:
                        continue
                    dx = left + i + 0.5 - float(s[0])
                    sigma = 0.5 * (s[2] * dx * dx + s[4] * dy * dy) + s[3] * dx * dy
                    alpha = min(cap, s[5] * exp(-sigma))
                    if sigma < 0.0 or alpha < 1.0 / 255.0:
                        continue
                    before = image[4, top + j, left + i]
                    after = before * (1.0 - alpha)
                    if after <= 1e-4:
                        full[j, i] = True
                        open_pixels -= 1
                        continue
                    weight = alpha * before
                    image[0, top + j, left + i] += weight * s[6]
                    image[1, top + j, left + i] += weight * s[7]
                    image[2, top + j, left + i] += weight * s[8]
                    image[3, top + j, left + i] += weight * s[9]
                    image[4, top + j, left + i] = after
                    last[top + j, left + i] = place


@compiled
@no_type_check
def blend_backward(
    splats: Array, members: Array, top: int, cap: float, image: Array, last: Array, d_image: Array, moments: Array
) -> None:
    """Sum the gradients of the splats of one row of tiles.

    Args:
        splats, members, top, cap, image, last: As for :func:`blend`.
        d_image: ``[5, H, W]``: the gradient of ``image``.
        moments: ``[m, MOMENTS]``, written.
    """
    height, width = last.shape
    columns = (width + TILE - 1) // TILE
    tall = min(TILE, height - top)
    offsets = np.empty(columns + 1, np.int64)
    lists, numbers = tiles_of(splats, members, columns, offsets)
    # One row an entry, summed member by member in the end, so that the sum never depends on the order of tiles.
    parts = np.zeros((lists.shape[0], MOMENTS), np.float32)
    passing = np.empty((TILE, TILE))
    behind = np.empty((TILE, TILE))
    for column in range(columns):
        left = column * TILE
        wide = min(TILE, width - left)
        deepest = -1
        for j in range(tall):
            for i in range(wide):
                passing[j, i] = image[4, top + j, left + i]
                behind[j, i] = d_image[4, top + j, left + i] * passing[j, i]
                deepest = max(deepest, last[top + j, left + i])
        for entry in range(offsets[column + 1] - 1, offsets[column] - 1, -1):
            place = lists[entry]
            if place > deepest:
                continue
            s = splats[members[place]]
            part = parts[numbers[entry]]
            reach = s[11]
            first_row = int(max(ceil(s[1] - reach - 0.51 - top), 0.0))
            last_row = int(min(floor(s[1] + reach - 0.49 - top), tall - 1.0))
            red = green = blue = depth = 0.0
            m0 = mx = my = mxx = mxy = myy = 0.0
            for j in range(first_row, last_row + 1):
                dy = top + j + 0.5 - float(s[1])
                first, final = row_interval(s, dy, left, wide)
                n0 = nx = nxx = 0.0
                for i in range(first, final + 1):
                    y, x = top + j, left + i
                    if place > last[y, x]:
                        continue
                    dx = left + i + 0.5 - float(s[0])
                    sigma = 0.5 * (s[2] * dx * dx + s[4] * dy * dy) + s[3] * dx * dy
                    covered = s[5] * exp(-sigma)
                    alpha = min(cap, covered)
                    if sigma < 0.0 or alpha < 1.0 / 255.0:
                        continue
                    before = passing[j, i] / (1.0 - alpha)
                    passing[j, i] = before
                    weight = alpha * before
                    red += weight * d_image[0, y, x]
                    green += weight * d_image[1, y, x]
                    blue += weight * d_image[2, y, x]
                    depth += weight * d_image[3, y, x]
                    value = (
                        s[6] * d_image[0, y, x]
                        + s[7] * d_image[1, y, x]
                        + s[8] * d_image[2, y, x]
                        + s[9] * d_image[3, y, x]
                    )
                    d_alpha = before * value - behind[j, i] / (1.0 - alpha)
                    behind[j, i] += weight * value
                    if covered <= cap:
                        slope = -covered * d_alpha
                        n0 += slope
                        nx += slope * dx
                        nxx += slope * dx * dx
                m0 += n0
                mx += nx
                my += dy * n0
                mxx += nxx
                mxy += dy * nx
                myy += dy * dy * n0
            part[0], part[1], part[2], part[3] = red, green, blue, depth
            part[4], part[5], part[6], part[7], part[8], part[9] = m0, mx, my, mxx, mxy, myy
    number = 0
    for i in range(members.shape[0]):
        moments[i] = 0.0
        first, final = tile_span(splats[members[i]], columns)
        for _ in range(first, final + 1):
            moments[i] += parts[number]
            number += 1
