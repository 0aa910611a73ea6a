"""Compiled kernels of plane-sweep stereo.

Images are ``[H, W]`` grey values in [0, 1], costs and their sums ``[H, W, D]``, homographies ``[S, D, 3, 3]`` from
pixels of the reference to those of each source. A kernel writes its last arguments.
"""

from functools import partial

import numpy as np

from anystyle.compiled import CONTRACT, compiled

Array = np.ndarray

kernel = partial(compiled, fastmath=CONTRACT | {"reassoc"})
NOISE = np.float32(2e-4)
"""Added to variances of grey values in [0, 1], so that the noise of flat regions does not correlate."""


@kernel
def warp(source: Array, homography: Array, warped: Array, inside: Array) -> None:
    """Sample an image bilinearly where a homography takes every pixel centre; at the border the image is continued."""
    height, width = source.shape
    h = homography.astype(np.float32)
    half, one = np.float32(0.5), np.float32(1)
    right, bottom = np.float32(width), np.float32(height)
    for y in range(warped.shape[0]):
        v = np.float32(y) + half
        for x in range(warped.shape[1]):
            u = np.float32(x) + half
            w = h[2, 0] * u + h[2, 1] * v + h[2, 2]
            s = (h[0, 0] * u + h[0, 1] * v + h[0, 2]) / w
            t = (h[1, 0] * u + h[1, 1] * v + h[1, 2]) / w
            inside[y, x] = (w > 0) & (s >= 0) & (s <= right) & (t >= 0) & (t <= bottom)
            s = min(max(s - half, np.float32(0)), right - one)
            t = min(max(t - half, np.float32(0)), bottom - one)
            i, j = min(int(s), width - 2), min(int(t), height - 2)
            a, b = s - np.float32(i), t - np.float32(j)
            top = source[j, i] + a * (source[j, i + 1] - source[j, i])
            low = source[j + 1, i] + a * (source[j + 1, i + 1] - source[j + 1, i])
            warped[y, x] = top + b * (low - top)


@kernel
def add_row(a: Array, b: Array, sign: float, columns: Array, radius: int) -> None:
    """Add (or subtract) a row of ``a``, ``a²`` and ``a b`` to sums of columns ``[3, W + 2 radius]``, padded after."""
    width = a.shape[0]
    for x in range(width):
        value = sign * a[x]
        columns[0, radius + x] += value
        columns[1, radius + x] += value * a[x]
        columns[2, radius + x] += value * b[x]
    for k in range(3):
        for x in range(radius):
            columns[k, x] = columns[k, radius]
            columns[k, radius + width + x] = columns[k, radius + width - 1]


@kernel
def window_row(columns: Array, radius: int, sums: Array) -> None:
    """Write the means over windows ``[3, W]`` from sums of columns ``[3, W + 2 radius]``."""
    width = sums.shape[1]
    fraction = np.float32(1.0 / (2 * radius + 1) ** 2)
    for k in range(3):
        for x in range(width):
            sums[k, x] = columns[k, x]
        for shift in range(1, 2 * radius + 1):
            for x in range(width):
                sums[k, x] += columns[k, x + shift]
        for x in range(width):
            sums[k, x] *= fraction


@kernel
def statistics(image: Array, radius: int, mean: Array, variance: Array) -> None:
    """Write mean and variance ``[H, W]`` of an image in square windows; the image is continued at its border."""
    height, width = image.shape
    columns, sums = np.zeros((3, width + 2 * radius), np.float32), np.empty((3, width), np.float32)
    for y in range(-radius, radius + 1):
        add_row(image[min(max(y, 0), height - 1)], image[0], np.float32(1), columns, radius)
    for y in range(height):
        window_row(columns, radius, sums)
        for x in range(width):
            mean[y, x] = sums[0, x]
            variance[y, x] = max(sums[1, x] - sums[0, x] * sums[0, x], np.float32(0))
        add_row(image[min(y + radius + 1, height - 1)], image[0], np.float32(1), columns, radius)
        add_row(image[max(y - radius, 0)], image[0], np.float32(-1), columns, radius)


@kernel
def dissimilarity(
    warped: Array, inside: Array, reference: Array, mean: Array, variance: Array, radius: int, cost: Array
) -> None:
    """Write 1 - ZNCC ``[H, W]`` of two images in square windows, at most 1, which it is outside."""
    height, width = reference.shape
    one = np.float32(1)
    columns, sums = np.zeros((3, width + 2 * radius), np.float32), np.empty((3, width), np.float32)
    for y in range(-radius, radius + 1):
        row = min(max(y, 0), height - 1)
        add_row(warped[row], reference[row], one, columns, radius)
    for y in range(height):
        window_row(columns, radius, sums)
        for x in range(width):
            spread = max(sums[1, x] - sums[0, x] * sums[0, x], np.float32(0))
            both = sums[2, x] - sums[0, x] * mean[y, x]
            value = one - both / np.sqrt((spread + NOISE) * (variance[y, x] + NOISE))
            cost[y, x] = min(value, one) if inside[y, x] else one
        last, first = min(y + radius + 1, height - 1), max(y - radius, 0)
        add_row(warped[last], reference[last], one, columns, radius)
        add_row(warped[first], reference[first], -one, columns, radius)


@kernel
def sweep(reference: Array, sources: Array, homographies: Array, radius: int, costs: Array) -> None:
    """Write the costs of planes: means over the better half of up to four sources, which leaves out the occluded."""
    height, width = reference.shape
    num_sources, num_planes = homographies.shape[:2]
    mean, variance = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    statistics(reference, radius, mean, variance)
    warped, inside = np.empty((height, width), np.float32), np.empty((height, width), np.bool_)
    cost, second = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    least = np.ones((num_planes, height, width), np.float32)
    for d in range(num_planes):
        second[:] = np.float32(1)
        for k in range(num_sources):
            warp(sources[k], homographies[k, d], warped, inside)
            dissimilarity(warped, inside, reference, mean, variance, radius, cost)
            for y in range(height):
                for x in range(width):
                    second[y, x] = min(second[y, x], max(least[d, y, x], cost[y, x]))
                    least[d, y, x] = min(least[d, y, x], cost[y, x])
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
