"""Compiled kernels: splats are sorted by depth, listed by tile, and blended nearest first; and the backward pass.

A tile is narrow and stored as contiguous planes, so that the rows a splat covers are one run of pixels: the inner loop
has no branches, uses single precision throughout, and compiles to vector instructions. Loops avoid slicing arrays:
reference counting would dominate.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from anystyle.compiled import CONTRACT
from anystyle.compiled import compiled as _compiled

compiled = partial(_compiled, fastmath=CONTRACT)
"""A product and a sum may be fused; the order of a sum stays."""

summed = partial(_compiled, fastmath=CONTRACT | {"reassoc"})
"""Sums may be reordered, so that they compile to vector instructions; their order is still the same in every run."""

Array = np.ndarray


class Tiles(NamedTuple):
    """The splats of each tile in a row of tiles, by :func:`tiles_of`; list ``i`` is ``offsets[i : i + 2]``."""

    lists: Array
    offsets: Array


class BlendedView(NamedTuple):
    """One view.

    Args:
        image: ``[5, H, W]``: red, green, blue, depth and transmittance.
        last: ``[H, W]``: the last entry of the tile's list before the pixel was full; -1 for none.
        d_image: The gradient of the image.
    """

    image: Array
    last: Array
    d_image: Array


class Shares(NamedTuple):
    """The shares of Gaussians in the pixels of a row of tiles, by runs of pixels that one splat covers in one line.

    Args:
        splats: ``[m, 2]``: the Gaussian; :data:`RUNS` times the tile's column, plus the number of the splat's runs.
        runs: ``[n]``: ``WIDTH`` times the first pixel, row by row through the tile, plus how many pixels follow it.
        values: The shares of each run's pixels in :data:`STEPS`, one run after another.
    """

    splats: Array
    runs: Array
    values: Array


class SortedSplats(NamedTuple):
    """The splats of one view.

    Args:
        data: ``[N, SPLAT]``, with room for every Gaussian.
        rows: ``[n]``: the rows of ``data`` that are splats, in the order of the Gaussians.
        owners: ``[N]``: the Gaussian of each row of ``data``.
        copies: ``[m, SPLAT]``: the splats of each row of tiles, concatenated, in the order of the Gaussians.
        places: ``[m]``: the row of ``data`` that each is a copy of.
        offsets: Where the copies for each row of tiles begin and end.
    """

    data: Array
    rows: Array
    owners: Array
    copies: Array
    places: Array
    offsets: Array

    def of(self, row: int) -> slice:
        """Where the copies for a row of tiles are."""
        return slice(self.offsets[row], self.offsets[row + 1])

    def tiles(self, row: int, size: tuple[int, ...]) -> Tiles:
        """The splats of each tile in a row of tiles of an image of a height and width."""
        offsets, top, splats = np.empty(-(-size[1] // WIDTH) + 1, np.int64), row * HEIGHT, self.copies[self.of(row)]
        bottom = min(HEIGHT, size[0] - top) - 1
        return Tiles(tiles_of(splats, top, bottom, size[1], offsets), offsets)


SPLAT = 16
"""Numbers of a splat, of which :mod:`anystyle_cpu_renderer.projection` names the columns: one cache line."""

HEIGHT, WIDTH = 32, 8
"""Of a tile in pixels: a row is a vector of most processors, planes fit into the L1 cache. A row of tiles is a job."""

BLOCK = 32
"""Splats of a tile that are blended before it is looked whether all its pixels are full."""

ZERO, ONE, HALF = np.float32(0), np.float32(1), np.float32(0.5)
STEPS = np.float32(65535)
"""Of shares that are kept, which lie in [0, 1]: half of the memory of a view."""
RUNS = np.uint64(64)
"""More than a splat has in a tile."""
ALMOST = np.float32(0.9999)
"""Added before truncation to an integer, to round up."""
MARGIN = np.float32(0.01)
"""Pixels by which a splat's extent is enlarged, so that none is lost by rounding."""


@compiled
def nearest_first(depths: Array) -> Array:
    """Indices of positive depths, nearest first: a stable radix sort, for bits of positive floats are ordered."""
    n = depths.shape[0]
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
def span(center: float, half: float, side: int, count: int) -> tuple[int, int]:
    """The first and the last of ``count`` tiles of a side that an interval of pixels may reach."""
    first = max((center - half - 1.0) / side, 0.0)
    last = min((center + half + 1.0) / side, count - 1.0)
    return int(first), int(last)


@compiled
def count_by_row(data: Array, rows: Array, offsets: Array) -> None:
    """Write where the copies for each row of tiles begin and end, see :func:`copy_by_row`."""
    last_row = offsets.shape[0] - 1
    offsets[:] = 0
    for i in range(rows.shape[0]):
        first, last = span(float(data[rows[i], 1]), float(data[rows[i], 11]), HEIGHT, last_row)
        for row in range(first, last + 1):
            offsets[row + 1] += 1
    for row in range(last_row):
        offsets[row + 1] += offsets[row]


@compiled
def copy_by_row(data: Array, rows: Array, offsets: Array, copies: Array, places: Array) -> None:
    """Copy the splats of each row of tiles next to each other: sorting and blending a row stays in the cache."""
    last_row, cursor = offsets.shape[0] - 1, offsets[:-1].copy()
    for i in range(rows.shape[0]):
        at = np.uint64(rows[i])
        first, last = span(float(data[at, 1]), float(data[at, 11]), HEIGHT, last_row)
        for row in range(first, last + 1):
            copy = np.uint64(cursor[row])
            places[copy] = at
            for k in range(SPLAT):
                copies[copy, k] = data[at, k]
            cursor[row] += 1


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
def tiles_of(splats: Array, top: int, bottom: int, width: int, offsets: Array) -> Array:
    """List the splats of every tile in a row of tiles, nearest first.

    ``[entries, 3]``: the splat, the first row of the tile that it covers, one past the last, which is the same for a
    splat that only seemed to reach the tile.
    """
    columns, number = offsets.shape[0] - 1, splats.shape[0]
    depths, starts, spans = (
        np.empty(number, np.float32),
        np.zeros(number + 1, np.int32),
        np.empty((number, 2), np.int16),
    )
    offsets[:] = 0
    for g in range(number):
        depths[g] = splats[g, 9]
        first, last = span(float(splats[g, 0]), float(splats[g, 10]), WIDTH, columns)
        spans[g, 0], spans[g, 1], starts[g + 1] = first, last, starts[g] + last + 1 - first
        for column in range(first, last + 1):
            offsets[column + 1] += 1
    for column in range(columns):
        offsets[column + 1] += offsets[column]
    # Splats are read in the order in which they lie in memory, and only their rows in that of their depths.
    rows = np.empty((offsets[columns], 2), np.int16)
    for g in range(number):
        y = np.float32(splats[g, 1] - top - 0.5)
        for column in range(spans[g, 0], spans[g, 1] + 1):
            x, entry = np.float32(splats[g, 0] - column * WIDTH - 0.5), starts[g] + column - spans[g, 0]
            border = min(WIDTH, width - column * WIDTH) - 1
            rows[entry, 0], rows[entry, 1] = reach(splats, g, x, y, np.float32(border), np.float32(bottom))
    cursor, lists, order = offsets[:-1].copy(), np.empty((offsets[columns], 3), np.int32), nearest_first(depths)
    for i in range(number):
        g = order[i]
        for column in range(spans[g, 0], spans[g, 1] + 1):
            entry, listed = starts[g] + column - spans[g, 0], cursor[column]
            lists[listed, 0], lists[listed, 1], lists[listed, 2] = g, rows[entry, 0], rows[entry, 1]
            cursor[column] += 1
    return lists


MOMENTS = 10
"""Sums over pixels from which the gradients of a splat follow: gradients of red, green, blue and depth; and with the
gradient ``s`` of ``sigma`` in a pixel at ``(dx, dy)`` from the splat, ``s, s dx, s dy, s dx², s dx dy, s dy²``."""

MIN_ALPHA = np.float32(1 / 255)
MIN_TRANSMITTANCE = np.float32(1e-4)
LOG2_E = np.float32(1.4426950408889634)
ROUNDING = np.float32(1.5 * 2**23)


@compiled
def falloff(sigma: float) -> np.float32:
    """``exp(-sigma)`` in single precision, to about two units in the last place; sigma is clamped to 80."""
    power = -LOG2_E * min(sigma, np.float32(80))
    # Adding ROUNDING rounds to an integer, which is then in the low bits of the sum.
    rounded = power + ROUNDING
    part = power - (rounded - ROUNDING)
    # The Taylor series of 2 ** part for |part| <= 0.5, in pairs of terms that can be evaluated in parallel.
    square = part * part
    low = ONE + np.float32(6.9314718055994531e-1) * part
    middle = np.float32(2.4022650695910072e-1) + np.float32(5.5504108664821580e-2) * part
    high = np.float32(9.6181291076284772e-3) + np.float32(1.3333558146428443e-3) * part
    high += np.float32(1.5403530393381610e-4) * square
    value = low + square * (middle + square * high)
    exponent = np.float32(rounded).view(np.int32) << np.int32(23)
    return np.int32(np.float32(value).view(np.int32) + exponent).view(np.float32)


WIDE = np.uint64(WIDTH)
"""Unsigned, as are loop indices: numba wraps negative indices of signed ones, which prevents vectorisation."""


@compiled
def blend(splats: Array, tiles: Tiles, top: int, cap: float, image: Array, last: Array) -> None:
    """Blend one row of tiles from the row of pixels ``top`` on into ``image`` and ``last`` of :class:`BlendedView`.

    ``cap`` is the largest alpha of one splat in a pixel.
    """
    lists, offsets = tiles
    for column in range(offsets.shape[0] - 1):
        entries = lists[offsets[column] : offsets[column + 1]]
        blend_tile(splats, entries, top, column * WIDTH, cap, image, last)


@compiled
def gather(splats: Array, entries: Array, start: int, stop: int, top: int, left: int) -> Array:
    """Copy entries of a tile into contiguous memory, which hides the latency of scattered reads.

    ``[stop - start, 10]``: column and row from the centre of the tile's first pixel, conic with its diagonal halved,
    opacity, colour and depth.
    """
    near = np.empty((stop - start, 10), np.float32)
    for e in range(start, stop):
        g, row = np.uint64(entries[e, 0]), e - start
        near[row, 0], near[row, 1] = splats[g, 0] - left - 0.5, splats[g, 1] - top - 0.5
        near[row, 2], near[row, 3], near[row, 4] = HALF * splats[g, 2], splats[g, 3], HALF * splats[g, 4]
        for k in range(5, 10):
            near[row, k] = splats[g, k]
    return near


@compiled
def blend_tile(splats: Array, entries: Array, top: int, left: int, cap: float, image: Array, last: Array) -> None:
    """Blend the splats ``entries`` of one tile; arguments as in :func:`blend`."""
    tall, wide = min(HEIGHT, last.shape[0] - top), min(WIDTH, last.shape[1] - left)
    # Planes: red, green, blue, depth, transmittance (negative once the pixel is full), last entry, column, row.
    tile = np.empty((8, HEIGHT * WIDTH), np.float32)
    for i in range(HEIGHT * WIDTH):
        for k in range(4):
            tile[k, i] = ZERO
        tile[4, i] = ONE if (i // WIDTH < tall) & (i % WIDTH < wide) else ZERO
        tile[5, i] = -ONE
        tile[6, i], tile[7, i] = np.float32(i % WIDTH), np.float32(i // WIDTH)
    near = gather(splats, entries, 0, 0, top, left)
    for entry in range(entries.shape[0]):
        if entry % BLOCK == 0:
            if passing(tile[4]) == ZERO:
                break
            near = gather(splats, entries, entry, min(entry + BLOCK, entries.shape[0]), top, left)
        index, e = np.float32(entry), np.uint64(entry % BLOCK)
        x, y, xx, xy, yy, opacity = near[e, 0], near[e, 1], near[e, 2], near[e, 3], near[e, 4], near[e, 5]
        red, green, blue, depth = near[e, 6], near[e, 7], near[e, 8], near[e, 9]
        for i in range(np.uint64(entries[entry, 1]) * WIDE, np.uint64(entries[entry, 2]) * WIDE):
            dx, dy = tile[6, i] - x, tile[7, i] - y
            sigma = (xx * dx + xy * dy) * dx + yy * dy * dy
            alpha = min(cap, opacity * falloff(sigma))
            alpha = alpha if (sigma >= ZERO) & (alpha >= MIN_ALPHA) else ZERO
            before = tile[4, i]
            after = before - before * alpha
            full = after <= MIN_TRANSMITTANCE
            weight = ZERO if full else alpha * before
            tile[0, i] += weight * red
            tile[1, i] += weight * green
            tile[2, i] += weight * blue
            tile[3, i] += weight * depth
            tile[4, i] = -abs(before) if full else after
            tile[5, i] = tile[5, i] if full else index
    for j in range(tall):
        for i in range(wide):
            at = j * WIDTH + i
            for k in range(4):
                image[k, top + j, left + i] = tile[k, at]
            image[4, top + j, left + i] = abs(tile[4, at])
            last[top + j, left + i] = int(tile[5, at])


@compiled
def shares(splats: Array, owners: Array, tiles: Tiles, tall: int, width: int, top: int, cap: float) -> Shares:
    """The shares of Gaussians in the pixels of a row of tiles, ``tall`` pixels high; ``owners`` are those of splats."""
    lists, offsets = tiles
    found = np.empty((lists.shape[0], 2), np.uint32)
    runs, values = np.empty(1 << 14, np.uint16), np.empty(max(8 * lists.shape[0], 1 << 14), np.uint16)
    covering = number = length = 0
    # Planes: transmittance (negative once the pixel is full), the share of the current splat, column, row.
    tile = np.empty((4, HEIGHT * WIDTH), np.float32)
    for column in range(offsets.shape[0] - 1):
        entries = lists[offsets[column] : offsets[column + 1]]
        left, wide = column * WIDTH, min(WIDTH, width - column * WIDTH)
        for i in range(HEIGHT * WIDTH):
            tile[0, i] = ONE if (i // WIDTH < tall) & (i % WIDTH < wide) else ZERO
            tile[2, i], tile[3, i] = np.float32(i % WIDTH), np.float32(i // WIDTH)
        near = gather(splats, entries, 0, 0, top, left)
        for entry in range(entries.shape[0]):
            if entry % BLOCK == 0:
                if passing(tile[0]) == ZERO:
                    break
                near = gather(splats, entries, entry, min(entry + BLOCK, entries.shape[0]), top, left)
            e = np.uint64(entry % BLOCK)
            x, y, xx, xy, yy, opacity = near[e, 0], near[e, 1], near[e, 2], near[e, 3], near[e, 4], near[e, 5]
            for i in range(np.uint64(entries[entry, 1]) * WIDE, np.uint64(entries[entry, 2]) * WIDE):
                dx, dy = tile[2, i] - x, tile[3, i] - y
                sigma = (xx * dx + xy * dy) * dx + yy * dy * dy
                alpha = min(cap, opacity * falloff(sigma))
                alpha = alpha if (sigma >= ZERO) & (alpha >= MIN_ALPHA) else ZERO
                before = tile[0, i]
                after = before - before * alpha
                full = after <= MIN_TRANSMITTANCE
                tile[1, i] = ZERO if full else alpha * before
                tile[0, i] = -abs(before) if full else after
            runs = runs if number + HEIGHT <= runs.shape[0] else longer(runs)
            values = values if length + HEIGHT * WIDTH <= values.shape[0] else longer(values)
            half, known = splats[entries[entry, 0], 10] + ONE, number
            begin, end = int(max(x - half, ZERO)), int(max(min(x + half + ONE, np.float32(wide)), ZERO))
            for row in range(entries[entry, 1], entries[entry, 2]):
                first, stop = np.uint64(row * WIDTH + begin), np.uint64(row * WIDTH + end)
                while first < stop and tile[1, first] * STEPS < ONE:
                    first += np.uint64(1)
                while first < stop and tile[1, stop - np.uint64(1)] * STEPS < ONE:
                    stop -= np.uint64(1)
                if first < stop:
                    runs[number] = first * WIDE + stop - first - np.uint64(1)
                    number += 1
                    for i in range(first, stop):
                        values[length] = np.uint16(tile[1, i] * STEPS + HALF)
                        length += 1
            if known < number:
                found[covering, 0] = owners[entries[entry, 0]]
                found[covering, 1] = column * RUNS + number - known
                covering += 1
    return Shares(found[:covering], runs[:number], values[:length])


@compiled
def mix(shares: Shares, colors: Array, image: Array) -> None:
    """Add the colours ``[N, 3]`` of Gaussians, times their shares, to pixels ``[rows, W, 3]``."""
    splats, runs, values = shares
    run = at = np.uint64(0)
    for splat in range(splats.shape[0]):
        owner, left = np.uint64(splats[splat, 0]), np.uint64(splats[splat, 1]) // RUNS * WIDE
        red, green, blue = colors[owner, 0] / STEPS, colors[owner, 1] / STEPS, colors[owner, 2] / STEPS
        for _ in range(np.uint64(splats[splat, 1]) % RUNS):
            first, count = np.uint64(runs[run]) // WIDE, np.uint64(runs[run]) % WIDE + np.uint64(1)
            y, x = first // WIDE, left + first % WIDE
            for i in range(count):
                share = np.float32(values[at + i])
                image[y, x + i, 0] += share * red
                image[y, x + i, 1] += share * green
                image[y, x + i, 2] += share * blue
            run, at = run + np.uint64(1), at + count


@compiled
def mix_transposed(shares: Shares, image: Array, colors: Array) -> None:
    """The transpose of :func:`mix`: add pixels ``[rows, W, 3]``, times the shares in them, to Gaussians ``[N, 3]``."""
    splats, runs, values = shares
    run = at = np.uint64(0)
    for splat in range(splats.shape[0]):
        owner, left = np.uint64(splats[splat, 0]), np.uint64(splats[splat, 1]) // RUNS * WIDE
        red = green = blue = ZERO
        for _ in range(np.uint64(splats[splat, 1]) % RUNS):
            first, count = np.uint64(runs[run]) // WIDE, np.uint64(runs[run]) % WIDE + np.uint64(1)
            y, x = first // WIDE, left + first % WIDE
            for i in range(count):
                share = np.float32(values[at + i])
                red += share * image[y, x + i, 0]
                green += share * image[y, x + i, 1]
                blue += share * image[y, x + i, 2]
            run, at = run + np.uint64(1), at + count
        colors[owner, 0] += red / STEPS
        colors[owner, 1] += green / STEPS
        colors[owner, 2] += blue / STEPS


@compiled
def longer(values: Array) -> Array:
    """The same values at the beginning of an array of twice the length."""
    return np.concatenate((values, np.empty_like(values)))


@summed
def passing(transmittance: Array) -> np.float32:
    """The sum of transmittance over the pixels of a tile that are not full."""
    value = ZERO
    for i in range(HEIGHT * WIDTH):
        value += max(transmittance[i], ZERO)
    return value


@compiled
def blend_backward(
    splats: Array, tiles: Tiles, top: int, cap: float, picture: BlendedView, moments: Array, shaped: bool
) -> None:
    """Accumulate ``moments [m, MOMENTS]`` of the splats of one row of tiles; other arguments as in :func:`blend`.

    Unless ``shaped``, only those of colours.
    """
    lists, offsets = tiles
    for column in range(offsets.shape[0] - 1):
        entries = lists[offsets[column] : offsets[column + 1]]
        if shaped:
            blend_tile_backward(splats, entries, top, column * WIDTH, cap, picture, moments)
        else:
            color_tile_backward(splats, entries, top, column * WIDTH, cap, picture, moments)


@compiled
def scatter(places: Array, row_moments: Array, moments: Array) -> None:
    """Add the moments ``[m, MOMENTS]`` of the copies of one row of tiles to those of all splats."""
    for i in range(places.shape[0]):
        for k in range(MOMENTS):
            moments[places[i], k] += row_moments[i, k]


@compiled
def tile_backward(top: int, left: int, picture: BlendedView) -> tuple[Array, int]:
    """The initial state of the backward pass through one tile, and the last entry that any of its pixels blended."""
    image, last, d_image = picture
    tall, wide = min(HEIGHT, last.shape[0] - top), min(WIDTH, last.shape[1] - left)
    # Planes: gradients of red, green, blue and depth, transmittance, gradient-weighted colour behind the current
    # splat, last entry, column, row.
    tile = np.empty((9, HEIGHT * WIDTH), np.float32)
    deepest = -1
    for i in range(HEIGHT * WIDTH):
        for k in range(6):
            tile[k, i] = ZERO
        tile[6, i] = -ONE
        tile[7, i], tile[8, i] = np.float32(i % WIDTH), np.float32(i // WIDTH)
    for j in range(tall):
        for i in range(wide):
            at = j * WIDTH + i
            for k in range(4):
                tile[k, at] = d_image[k, top + j, left + i]
            tile[4, at] = image[4, top + j, left + i]
            tile[5, at] = d_image[4, top + j, left + i] * image[4, top + j, left + i]
            tile[6, at] = last[top + j, left + i]
            deepest = max(deepest, last[top + j, left + i])
    return tile, deepest


@summed
def blend_tile_backward(
    splats: Array, entries: Array, top: int, left: int, cap: float, picture: BlendedView, moments: Array
) -> None:
    """Accumulate gradients of the splats ``entries`` of one tile; arguments as in :func:`blend_backward`."""
    tile, deepest = tile_backward(top, left, picture)
    near = gather(splats, entries, 0, deepest + 1, top, left)
    for entry in range(deepest, -1, -1):
        index, e = np.float32(entry), np.uint64(entry)
        x, y, xx, xy, yy, opacity = near[e, 0], near[e, 1], near[e, 2], near[e, 3], near[e, 4], near[e, 5]
        red, green, blue, depth = near[e, 6], near[e, 7], near[e, 8], near[e, 9]
        d_red = d_green = d_blue = d_depth = m0 = mx = my = mxx = mxy = myy = ZERO
        for i in range(np.uint64(entries[entry, 1]) * WIDE, np.uint64(entries[entry, 2]) * WIDE):
            dx, dy = tile[7, i] - x, tile[8, i] - y
            sigma = (xx * dx + xy * dy) * dx + yy * dy * dy
            covered = opacity * falloff(sigma)
            alpha = min(cap, covered)
            shown = (sigma >= ZERO) & (alpha >= MIN_ALPHA) & (index <= tile[6, i])
            alpha = alpha if shown else ZERO
            inverse = ONE / (ONE - alpha)
            before = tile[4, i] * inverse
            weight = alpha * before
            value = red * tile[0, i] + green * tile[1, i] + blue * tile[2, i] + depth * tile[3, i]
            slope = covered * (tile[5, i] * inverse - before * value)
            slope = slope if shown & (covered <= cap) else ZERO
            tile[4, i] = before
            tile[5, i] += weight * value
            d_red += weight * tile[0, i]
            d_green += weight * tile[1, i]
            d_blue += weight * tile[2, i]
            d_depth += weight * tile[3, i]
            m0 += slope
            mx += slope * dx
            my += slope * dy
            mxx += slope * dx * dx
            mxy += slope * dx * dy
            myy += slope * dy * dy
        part = np.uint64(entries[entry, 0])
        sums = d_red, d_green, d_blue, d_depth, m0, mx, my, mxx, mxy, myy
        for k in range(MOMENTS):
            moments[part, k] += sums[k]


@summed
def color_tile_backward(
    splats: Array, entries: Array, top: int, left: int, cap: float, picture: BlendedView, moments: Array
) -> None:
    """:func:`blend_tile_backward` for colours only, which is about half the work."""
    tile, deepest = tile_backward(top, left, picture)
    near = gather(splats, entries, 0, deepest + 1, top, left)
    for entry in range(deepest, -1, -1):
        index, e = np.float32(entry), np.uint64(entry)
        x, y, xx, xy, yy, opacity = near[e, 0], near[e, 1], near[e, 2], near[e, 3], near[e, 4], near[e, 5]
        d_red = d_green = d_blue = ZERO
        for i in range(np.uint64(entries[entry, 1]) * WIDE, np.uint64(entries[entry, 2]) * WIDE):
            dx, dy = tile[7, i] - x, tile[8, i] - y
            sigma = (xx * dx + xy * dy) * dx + yy * dy * dy
            alpha = min(cap, opacity * falloff(sigma))
            alpha = alpha if (sigma >= ZERO) & (alpha >= MIN_ALPHA) & (index <= tile[6, i]) else ZERO
            before = tile[4, i] / (ONE - alpha)
            tile[4, i] = before
            d_red += alpha * before * tile[0, i]
            d_green += alpha * before * tile[1, i]
            d_blue += alpha * before * tile[2, i]
        part = np.uint64(entries[entry, 0])
        moments[part, 0] += d_red
        moments[part, 1] += d_green
        moments[part, 2] += d_blue
