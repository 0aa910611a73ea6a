"""Compiled kernels: the projection of Gaussians to splats in one image.

They follow :func:`anystyle.geometry.projection.project` and :func:`anystyle.geometry.harmonics.colors`, one Gaussian
at a time in double precision. A splat is a row of 16 numbers, one cache line; the constants below name the columns.
"""

from math import isfinite, log, sqrt

import numpy as np

from anystyle_cpu_renderer.compiled import compiled

Array = np.ndarray

X, Y, XX, XY, YY, OPACITY, RED, GREEN, BLUE, DEPTH, WIDE, TALL, PEAK, LEAN, BEND = range(15)
"""A splat: image position, conic, opacity, colour and depth, and the ellipse in which alpha is at least 1/255: its half
extents, the column of its highest point, and its rows at a distance ``dx`` from the centre, ``LEAN dx ± BEND sqrt(WIDE²
- dx²)``."""

SPLAT = 16
CAMERA = 19
"""A camera: the rows of the rotation (9) and the translation (3) from world, its origin (3), fx, fy, cx, cy."""

MARGIN = 0.15
"""As :data:`anystyle.geometry.projection.FRUSTUM_MARGIN`."""


@compiled
def harmonics_at(x: float, y: float, z: float, tables: Array, values: Array) -> None:
    """Write the harmonics at a unit vector."""
    cosine, sine = 1.0, 0.0
    diagonal = 1.0
    for m in range(tables.shape[1]):
        p, below = diagonal, 0.0
        for n in range(m, tables.shape[1]):
            if n > m:
                p, below = tables[1, n, m] * z * p - tables[2, n, m] * below, p
            values[n * n + n + m] = tables[0, n, m] * p * cosine
            if m > 0:
                values[n * n + n - m] = tables[0, n, m] * p * sine
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
        diagonal *= 2 * m + 1


@compiled
def harmonics_slopes(x: float, y: float, z: float, tables: Array, values: Array, slopes: Array) -> None:
    """Write the harmonics at a unit vector and their partial derivatives as polynomials in x, y, z."""
    cosine, sine, less_cosine, less_sine = 1.0, 0.0, 0.0, 0.0
    diagonal = 1.0
    for m in range(tables.shape[1]):
        p, dp, below, d_below = diagonal, 0.0, 0.0, 0.0
        for n in range(m, tables.shape[1]):
            if n > m:
                p_next = tables[1, n, m] * z * p - tables[2, n, m] * below
                dp_next = tables[1, n, m] * (p + z * dp) - tables[2, n, m] * d_below
                p, dp, below, d_below = p_next, dp_next, p, dp
            scaled, d_scaled = tables[0, n, m] * p, tables[0, n, m] * dp
            k = n * n + n
            values[k + m] = scaled * cosine
            slopes[k + m, 0] = scaled * m * less_cosine
            slopes[k + m, 1] = -scaled * m * less_sine
            slopes[k + m, 2] = d_scaled * cosine
            if m > 0:
                values[k - m] = scaled * sine
                slopes[k - m, 0] = scaled * m * less_sine
                slopes[k - m, 1] = scaled * m * less_cosine
                slopes[k - m, 2] = d_scaled * sine
        less_cosine, less_sine = cosine, sine
        cosine, sine = x * less_cosine - y * less_sine, x * less_sine + y * less_cosine
        diagonal *= 2 * m + 1


@compiled
def project(
    means: Array,
    covariances: Array,
    opacities: Array,
    harmonics: Array,
    camera: Array,
    limits: Array,
    tables: Array,
    start: int,
    stop: int,
    splats: Array,
    owners: Array,
) -> int:
    """Write the splats of the Gaussians ``start .. stop`` that are visible in an image."""
    r, t, origin = camera[:9], camera[9:12], camera[12:15]
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    width, height, near, far, blur = limits[0], limits[1], limits[2], limits[3], limits[4]
    low_u, high_u = -(cx + MARGIN * width) / fx, (width - cx + MARGIN * width) / fx
    low_v, high_v = -(cy + MARGIN * height) / fy, (height - cy + MARGIN * height) / fy
    count = harmonics.shape[1]
    basis = np.full(count, tables[0, 0, 0])
    written = start
    for g in range(start, stop):
        opacity = float(opacities[g])
        mx, my, mz = float(means[g, 0]), float(means[g, 1]), float(means[g, 2])
        z = r[6] * mx + r[7] * my + r[8] * mz + t[2]
        if not (opacity >= 1.0 / 255.0 and z >= near and z <= far):
            continue
        u = (r[0] * mx + r[1] * my + r[2] * mz + t[0]) / z
        v = (r[3] * mx + r[4] * my + r[5] * mz + t[1]) / z
        bu, bv = min(max(u, low_u), high_u), min(max(v, low_v), high_v)
        sx, sy = fx / z, fy / z
        a0, a1, a2 = sx * (r[0] - bu * r[6]), sx * (r[1] - bu * r[7]), sx * (r[2] - bu * r[8])
        b0, b1, b2 = sy * (r[3] - bv * r[6]), sy * (r[4] - bv * r[7]), sy * (r[5] - bv * r[8])
        c = covariances[g]
        p0, p1, p2 = (
            c[0] * a0 + c[1] * a1 + c[2] * a2,
            c[1] * a0 + c[3] * a1 + c[4] * a2,
            c[2] * a0 + c[4] * a1 + c[5] * a2,
        )
        q0, q1, q2 = (
            c[0] * b0 + c[1] * b1 + c[2] * b2,
            c[1] * b0 + c[3] * b1 + c[4] * b2,
            c[2] * b0 + c[4] * b1 + c[5] * b2,
        )
        xx = a0 * p0 + a1 * p1 + a2 * p2 + blur
        xy = b0 * p0 + b1 * p1 + b2 * p2
        yy = b0 * q0 + b1 * q1 + b2 * q2 + blur
        determinant = xx * yy - xy * xy
        px, py = fx * u + cx, fy * v + cy
        # The ellipse in which alpha is at least 1/255.
        reach = 2.0 * log(255.0 * opacity)
        wide, tall = sqrt(reach * xx), sqrt(reach * yy)
        seen = px + wide > 0.0 and px - wide < width and py + tall > 0.0 and py - tall < height
        if not (seen and determinant > 0.0 and isfinite(determinant)):
            continue
        s = splats[written]
        s[0], s[1], s[5], s[9], s[10], s[11] = px, py, opacity, z, wide, tall
        s[2], s[3], s[4] = yy / determinant, -xy / determinant, xx / determinant
        s[12], s[13], s[14] = xy * sqrt(reach / yy), xy / xx, sqrt(determinant) / xx
        if count > 1:
            dx, dy, dz = mx - origin[0], my - origin[1], mz - origin[2]
            norm = max(sqrt(dx * dx + dy * dy + dz * dz), 1e-12)
            harmonics_at(dx / norm, dy / norm, dz / norm, tables, basis)
        red = green = blue = 0.5
        for k in range(count):
            red += basis[k] * harmonics[g, k, 0]
            green += basis[k] * harmonics[g, k, 1]
            blue += basis[k] * harmonics[g, k, 2]
        s[6], s[7], s[8] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
        owners[written] = g
        written += 1
    return written - start
