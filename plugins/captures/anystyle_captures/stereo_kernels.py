"""Compiled kernels of plane-sweep stereo.

Images are ``[H, W]`` grey values in [0, 1], costs and their sums ``[H, W, D]``, homographies ``[S, D, 3, 3]`` from
pixels of the reference to those of each source. A kernel writes its last arguments.
"""

from functools import partial

import numpy as np

from anystyle.compiled import CONTRACT, compiled

Array = np.ndarray

kernel = partial(compiled, fastmath=CONTRACT | {"reassoc"})
RADIUS = 3
SIDE = 2 * RADIUS + 1
"""Windows have a side of so many pixels."""
NOISE = np.float32(2e-4)
"""Added to variances of grey values in [0, 1], so that the noise of flat regions does not correlate."""


@kernel
def places(
    h: Array, y: int, width: int, height: int, inside: Array, corners: Array, across: Array, down: Array
) -> None:
    """Where a homography takes the pixels of row ``y``: the upper left one of four to blend, by index, and shares."""
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    right, bottom, v = np.float32(width), np.float32(height), np.float32(y) + half
    for x in range(corners.shape[0]):
        u = np.float32(x) + half
        w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
        s = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w
        t = (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w
        inside[x] = (w > zero) & (s >= zero) & (s <= right) & (t >= zero) & (t <= bottom)
        # In this order what is not a number, 0 / 0, becomes zero.
        s, t = min(max(zero, s - half), right - one), min(max(zero, t - half), bottom - one)
        i, j = min(np.floor(s), right - one - one), min(np.floor(t), bottom - one - one)
        corners[x], across[x], down[x] = np.int32(j) * np.int32(width) + np.int32(i), s - i, t - j


@kernel
def blend(texels: Array, width: int, corners: Array, across: Array, down: Array, row: Array) -> None:
    """Interpolate bilinearly. Indices without a sign are looked up without a test for one."""
    one, below = np.uint64(1), np.uint64(width)
    for x in range(row.shape[0]):
        k = corners[x]
        top = texels[k] + across[x] * (texels[k + one] - texels[k])
        k = k + below
        low = texels[k] + across[x] * (texels[k + one] - texels[k])
        row[x] = top + down[x] * (low - top)


@kernel
def warp(source: Array, homography: Array, warped: Array, inside: Array) -> None:
    """Sample an image bilinearly where a homography takes every pixel centre; at the border the image is continued."""
    height, width = source.shape
    h, texels, count = homography.astype(np.float32), source.reshape(-1), warped.shape[1]
    corners, across, down = np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.float32)
    for y in range(warped.shape[0]):
        places(h, y, width, height, inside[y], corners, across, down)
        blend(texels, width, corners.view(np.uint32), across, down, warped[y])


@kernel
def slide(a: Array, b: Array, left_a: Array, left_b: Array, columns: Array) -> None:
    """Take a row into sums of ``a``, ``a²`` and ``a b`` over columns ``[3, W + 2 RADIUS]``, padded, and one out."""
    width = a.shape[0]
    for x in range(width):
        columns[0, RADIUS + x] += a[x] - left_a[x]
        columns[1, RADIUS + x] += a[x] * a[x] - left_a[x] * left_a[x]
        columns[2, RADIUS + x] += a[x] * b[x] - left_a[x] * left_b[x]
    for k in range(3):
        for x in range(RADIUS):
            columns[k, x] = columns[k, RADIUS]
            columns[k, RADIUS + width + x] = columns[k, RADIUS + width - 1]


@kernel
def dissimilarity(columns: Array, mean: Array, variance: Array, row: Array) -> None:
    """Write 1 - ZNCC of windows, given such sums, and mean and variance of the reference."""
    area = np.float32(SIDE * SIDE)
    for x in range(row.shape[0]):
        a, aa, ab = columns[0, x], columns[1, x], columns[2, x]
        for shift in range(1, SIDE):
            a += columns[0, x + shift]
            aa += columns[1, x + shift]
            ab += columns[2, x + shift]
        a, aa, ab = a / area, aa / area, ab / area
        spread = max(aa - a * a, np.float32(0))
        row[x] = np.float32(1) - (ab - a * mean[x]) / np.sqrt((spread + NOISE) * (variance[x] + NOISE))


@kernel
def keep_two(row: Array, inside: Array, least: Array, second: Array) -> None:
    """Keep the two smallest costs of each pixel; a cost is at most 1, which it is outside."""
    for x in range(row.shape[0]):
        value = row[x] if inside[x] else np.float32(1)
        second[x] = min(second[x], max(least[x], value))
        least[x] = min(least[x], value)


@kernel
def sweep(reference: Array, mean: Array, variance: Array, sources: Array, homographies: Array, costs: Array) -> None:
    """Write the costs of planes, 1 - ZNCC in square windows of images that are continued at their borders.

    They are means over the better half of up to four sources, which leaves out the occluded.
    """
    height, width = reference.shape
    num_sources, num_planes = homographies.shape[:2]
    warped, inside = np.empty((height, width), np.float32), np.empty((height, width), np.bool_)
    nothing, row = np.zeros(width, np.float32), np.empty(width, np.float32)
    second, least = np.empty((height, width), np.float32), np.ones((num_planes, height, width), np.float32)
    for d in range(num_planes):
        second[:] = np.float32(1)
        for k in range(num_sources):
            warp(sources[k], homographies[k, d], warped, inside)
            columns = np.zeros((3, width + 2 * RADIUS), np.float32)
            for y in range(-RADIUS, height + RADIUS):
                new, old = min(max(y, 0), height - 1), min(max(y - SIDE, 0), height - 1)
                if y <= RADIUS:
                    slide(warped[new], reference[new], nothing, nothing, columns)
                else:
                    slide(warped[new], reference[new], warped[old], reference[old], columns)
                if y >= RADIUS:
                    middle = y - RADIUS
                    dissimilarity(columns, mean[middle], variance[middle], row)
                    keep_two(row, inside[middle], least[d, middle], second[middle])
        if num_sources > 2:
            least[d] = (least[d] + second) / np.float32(2)
    # All planes of a pixel together, which lie side by side in memory.
    for y in range(height):
        for x in range(width):
            for d in range(num_planes):
                costs[y, x, d] = max(least[d, y, x], np.float32(0))


@kernel
def aggregate(costs: Array, gray: Array, small: float, large: float, sums: Array) -> None:
    """Semi-global aggregation (Hirschmüller 2008) along the four directions of rows and columns.

    ``small`` is the cost of a step to the next plane, ``large`` of any other one between pixels of equal grey value.
    """
    height, width, num_planes = costs.shape
    before, current = np.empty(num_planes + 2, np.float32), np.empty(num_planes + 2, np.float32)
    sums[:] = np.float32(0)
    for direction in range(4):
        along_rows = direction < 2
        num_lines, length = (height, width) if along_rows else (width, height)
        for line in range(num_lines):
            before[:] = np.float32(0)
            last = np.float32(0)
            for step in range(length):
                index = step if direction % 2 == 0 else length - 1 - step
                y, x = (line, index) if along_rows else (index, line)
                value = gray[y, x]
                jump = max(np.float32(1.2) * small, large / (np.float32(1) + np.float32(20) * abs(value - last)))
                best = before[1]
                for d in range(num_planes):
                    best = min(best, before[d + 1])
                # Sentinels beside the first and the last plane, which no step comes from.
                before[0] = before[num_planes + 1] = best + jump
                for d in range(num_planes):
                    neighbor = min(before[d], before[d + 2]) + small
                    current[d + 1] = costs[y, x, d] + min(min(before[d + 1], neighbor), best + jump) - best
                for d in range(num_planes):
                    sums[y, x, d] += current[d + 1]
                before, current = current, before
                last = value


@kernel
def best_planes(costs: Array, sums: Array, planes: Array, confidence: Array) -> None:
    """Write each pixel's best plane, to a fraction by a parabola through its aggregated costs."""
    height, width, num_planes = costs.shape
    for y in range(height):
        for x in range(width):
            best = 0
            for d in range(1, num_planes):
                best = d if sums[y, x, d] < sums[y, x, best] else best
            offset = np.float32(0)
            if 0 < best < num_planes - 1:
                a, b, c = sums[y, x, best - 1], sums[y, x, best], sums[y, x, best + 1]
                offset = np.float32(0.5) * (a - c) / max(a - b - b + c, np.float32(1e-6))
            planes[y, x] = np.float32(best) + min(max(offset, np.float32(-0.5)), np.float32(0.5))
            confidence[y, x] = np.float32(1) - costs[y, x, best]
