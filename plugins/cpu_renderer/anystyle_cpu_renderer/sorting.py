"""Compiled kernels: sorting splats by depth, and listing them by tile."""

import numpy as np

from anystyle_cpu_renderer.compiled import compiled

Array = np.ndarray

HEIGHT, WIDTH = 32, 16
"""Of a tile in pixels: its planes fit into the L1 cache. A job is one row of tiles."""

ZERO, ONE = np.float32(0), np.float32(1)
ALMOST = np.float32(0.9999)
"""Added before truncation to an integer, to round up."""
MARGIN = np.float32(0.01)
"""Pixels by which a splat's extent is enlarged, so that none is lost by rounding."""


@compiled
def nearest_first(splats: Array, rows: Array) -> Array:
    """Stable radix sort of splats by depth; the bits of positive floats are ordered as the floats are.

    Args:
        splats: ``[N, SPLAT]``.
        rows: ``[n]``: which rows to sort.

    Returns:
        Indices into ``rows``, nearest first.
    """
    n = rows.shape[0]
    depths = np.empty(n, np.float32)
    for i in range(n):
        depths[i] = splats[rows[i], 9]
    keys = depths.view(np.uint32)
    source, target = np.arange(n).astype(np.int32), np.empty(n, np.int32)
    counts = np.empty(2048, np.int64)
    for shift in (0, 11, 22):
        counts[:] = 0
        for i in range(n):
            counts[(keys[i] >> np.uint32(shift)) & np.uint32(2047)] += 1
        total = 0
        for digit in range(2048):
            total += counts[digit]
            counts[digit] = total - counts[digit]
        for i in range(n):
            digit = (keys[source[i]] >> np.uint32(shift)) & np.uint32(2047)
            target[counts[digit]] = source[i]
            counts[digit] += 1
        source, target = target, source
    return source


@compiled
def arrange(splats: Array, rows: Array, order: Array, sorted_splats: Array, ranks: Array) -> None:
    """Copy ``rows[order]`` of splats to ``sorted_splats``, and write the new index of each of ``rows`` to ``ranks``."""
    for i in range(rows.shape[0]):
        row = rows[order[i]]
        for k in range(splats.shape[1]):
            sorted_splats[i, k] = splats[row, k]
        ranks[order[i]] = i


@compiled
def span(center: float, half: float, side: int, count: int) -> tuple[int, int]:
    """The first and the last of ``count`` tiles of a side that an interval of pixels may reach."""
    first = max((center - half - 1.0) / side, 0.0)
    last = min((center + half + 1.0) / side, count - 1.0)
    return int(first), int(last)


@compiled
def rows_of(splats: Array, offsets: Array) -> Array:
    """List the splats of every row of tiles, in the order of ``splats``."""
    rows = offsets.shape[0] - 1
    offsets[:] = 0
    for i in range(splats.shape[0]):
        first, last = span(float(splats[i, 1]), float(splats[i, 11]), HEIGHT, rows)
        for row in range(first, last + 1):
            offsets[row + 1] += 1
    for row in range(rows):
        offsets[row + 1] += offsets[row]
    cursor = offsets[:-1].copy()
    lists = np.empty(offsets[rows], np.int32)
    for i in range(splats.shape[0]):
        first, last = span(float(splats[i, 1]), float(splats[i, 11]), HEIGHT, rows)
        for row in range(first, last + 1):
            lists[cursor[row]] = i
            cursor[row] += 1
    return lists


@compiled
def reach(splats: Array, g: int, x: float, y: float, border: float, bottom: float) -> tuple[np.int32, np.int32]:
    """The rows of a tile in which the alpha of a splat is at least 1/255."""
    wide, peak, lean, bend = splats[g, 10], splats[g, 12], splats[g, 13], splats[g, 14]
    # The lowest and the highest point of the part of the ellipse in the columns of the tile.
    near, far = -x - MARGIN, border - x + MARGIN
    right, left = min(max(peak, near), far), min(max(-peak, near), far)
    high = lean * right + bend * np.sqrt(max(wide * wide - right * right, ZERO))
    low = lean * left - bend * np.sqrt(max(wide * wide - left * left, ZERO))
    first = np.int32(max(y + low - MARGIN + ALMOST, ZERO))
    return first, max(np.int32(max(min(y + high + MARGIN, bottom) + ONE, ZERO)), first)


@compiled
def tiles_of(splats: Array, members: Array, top: int, bottom: int, width: int, offsets: Array) -> Array:
    """List the splats of every tile in a row of tiles.

    ``[entries, 4]``: the splat, its index in ``members``, the first row of the tile that it covers, one past the last.
    """
    columns = offsets.shape[0] - 1
    most = 0
    for i in range(members.shape[0]):
        first, last = span(float(splats[members[i], 0]), float(splats[members[i], 10]), WIDTH, columns)
        most += max(last + 1 - first, 0)
    entries = np.empty((most, 5), np.int32)
    offsets[:] = 0
    number = 0
    for i in range(members.shape[0]):
        g = members[i]
        first, last = span(float(splats[g, 0]), float(splats[g, 10]), WIDTH, columns)
        y = np.float32(splats[g, 1] - top - 0.5)
        for column in range(first, last + 1):
            x = np.float32(splats[g, 0] - column * WIDTH - 0.5)
            border = min(WIDTH, width - column * WIDTH) - 1
            low, high = reach(splats, g, x, y, np.float32(border), np.float32(bottom))
            if high > low:
                row = entries[number]
                row[0], row[1], row[2], row[3], row[4] = g, i, low, high, column
                offsets[column + 1] += 1
                number += 1
    for column in range(columns):
        offsets[column + 1] += offsets[column]
    cursor = offsets[:-1].copy()
    lists = np.empty((number, 4), np.int32)
    for i in range(number):
        at = cursor[entries[i, 4]]
        for k in range(4):
            lists[at, k] = entries[i, k]
        cursor[entries[i, 4]] += 1
    return lists
