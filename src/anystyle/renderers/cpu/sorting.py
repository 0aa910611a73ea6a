"""Compiled kernels: which splats a tile shows, nearest first."""

from typing import no_type_check

import numpy as np

from anystyle.renderers.cpu.compiled import compiled

Array = np.ndarray

HEIGHT, WIDTH = 32, 8
"""Of a tile in pixels: what is blended of it fits into the fastest cache. A job is one row of tiles."""


@compiled
@no_type_check
def nearest_first(splats: Array, rows: Array) -> Array:
    """Sort rows of splats by depth, stable: a radix sort over the bits of positive floats, which grow with them.

    Args:
        splats: ``[N, SPLAT]``.
        rows: ``[n]``: which rows to sort.

    Returns:
        Places in ``rows``, nearest first.
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
@no_type_check
def arrange(splats: Array, rows: Array, order: Array, sorted_splats: Array, places: Array) -> None:
    """Copy splats in an order.

    Args:
        splats: ``[N, SPLAT]``.
        rows: ``[n]``: which rows to copy.
        order: ``[n]``: places in ``rows``.
        sorted_splats: ``[n, SPLAT]``, written.
        places: ``[n]``, written: where each of ``rows`` went.
    """
    for i in range(rows.shape[0]):
        row = rows[order[i]]
        for k in range(splats.shape[1]):
            sorted_splats[i, k] = splats[row, k]
        places[order[i]] = i


@compiled
@no_type_check
def span(center: float, half: float, side: int, count: int) -> tuple[int, int]:
    """The first and the last of ``count`` tiles of a side that an interval of pixels may reach."""
    first = max((center - half - 1.0) / side, 0.0)
    last = min((center + half + 1.0) / side, count - 1.0)
    return int(first), int(last)


@compiled
@no_type_check
def rows_of(splats: Array, offsets: Array) -> Array:
    """List the splats of every row of tiles, in the order of ``splats``.

    Args:
        splats: ``[n, SPLAT]``, nearest first.
        offsets: ``[rows + 1]``, written: where the list of each row begins and ends.

    Returns:
        The lists, one behind the other.
    """
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
@no_type_check
def tiles_of(splats: Array, members: Array, offsets: Array, starts: Array) -> tuple[Array, Array]:
    """List the splats of every tile in a row of tiles.

    Args:
        splats: ``[n, SPLAT]``, nearest first.
        members: ``[m]``: which of them are in the row.
        offsets: ``[columns + 1]``, written: where the list of each tile begins and ends.
        starts: ``[m + 1]``, written: when entries are counted splat by splat, where those of each begin and end.

    Returns:
        The lists of splats, one behind the other, and the number of each entry when counted splat by splat.
    """
    columns = offsets.shape[0] - 1
    offsets[:] = 0
    for i in range(members.shape[0]):
        first, last = span(float(splats[members[i], 0]), float(splats[members[i], 10]), WIDTH, columns)
        for column in range(first, last + 1):
            offsets[column + 1] += 1
    for column in range(columns):
        offsets[column + 1] += offsets[column]
    cursor = offsets[:-1].copy()
    lists, numbers = np.empty(offsets[columns], np.int32), np.empty(offsets[columns], np.int32)
    starts[0] = 0
    for i in range(members.shape[0]):
        first, last = span(float(splats[members[i], 0]), float(splats[members[i], 10]), WIDTH, columns)
        starts[i + 1] = starts[i] + last + 1 - first
        for column in range(first, last + 1):
            lists[cursor[column]] = members[i]
            numbers[cursor[column]] = starts[i] + column - first
            cursor[column] += 1
    return lists, numbers
