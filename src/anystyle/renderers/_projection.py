"""Compiled kernels: from Gaussians in space to splats in one image, and back for gradients.

They follow :func:`anystyle.geometry.projection.project` and :func:`anystyle.geometry.harmonics.colors`, one Gaussian
at a time in double precision. A splat is a row of 12 numbers, named by the constants below.
"""

from math import isfinite, log, sqrt
from typing import no_type_check

import numpy as np

from anystyle.renderers._compiled import compiled

Array = np.ndarray

X, Y, XX, XY, YY, OPACITY, RED, GREEN, BLUE, DEPTH, WIDE, TALL = range(12)
"""A splat: image position, conic, opacity, what it shows, and the half extents of where it is seen."""

SPLAT = 12
CAMERA = 19
"""A camera: the rows of its rotation (9) and its translation (3) from world, its origin (3), fx, fy, cx, cy."""

MARGIN = 0.15
"""As :data:`anystyle.geometry.projection.FRUSTUM_MARGIN`."""


@compiled
@no_type_check
def harmonics_at(x: float, y: float, z: float, tables: Array, values: Array) -> None:
    """Write the harmonics at a unit vector.

    Args:
        x: Of the unit vector.
        y: Of the unit vector.
        z: Of the unit vector.
        tables: ``[3, degree + 1, degree + 1]``: normalisations of degree and order, and the two factors of the
            recurrence of Legendre polynomials over the degree.
        values: ``[K]``, written.
    """
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
@no_type_check
def harmonics_slopes(x: float, y: float, z: float, tables: Array, values: Array, slopes: Array) -> None:
    """Write the harmonics at a unit vector and their derivatives along the axes, continued smoothly off the sphere.

    Args:
        x: Of the unit vector.
        y: Of the unit vector.
        z: Of the unit vector.
        tables: As for :func:`harmonics_at`.
        values: ``[K]``, written.
        slopes: ``[K, 3]``, written.
    """
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
@no_type_check
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
    """Write the splats of those of the Gaussians ``start .. stop`` that an image shows.

    Args:
        means: ``[N, 3]``.
        covariances: ``[N, 6]``, packed.
        opacities: ``[N]``.
        harmonics: ``[N, K, 3]``.
        camera: ``[CAMERA]``.
        limits: width, height, near, far, and the variance of the low-pass filter.
        tables: As for :func:`harmonics_at`.
        start: The first; also the first row that is written.
        stop: One behind the last.
        splats: ``[N, SPLAT]``, written.
        owners: ``[N]``, written: the Gaussian that a splat is of.

    Returns:
        How many splats were written.
    """
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
        # Where it covers at least 1/255 of a pixel.
        reach = 2.0 * log(255.0 * opacity)
        wide, tall = sqrt(reach * xx), sqrt(reach * yy)
        seen = px + wide > 0.0 and px - wide < width and py + tall > 0.0 and py - tall < height
        if not (seen and determinant > 0.0 and isfinite(determinant)):
            continue
        s = splats[written]
        s[0], s[1], s[5], s[9], s[10], s[11] = px, py, opacity, z, wide, tall
        s[2], s[3], s[4] = yy / determinant, -xy / determinant, xx / determinant
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


@compiled
@no_type_check
def project_backward(
    means: Array,
    covariances: Array,
    harmonics: Array,
    camera: Array,
    limits: Array,
    tables: Array,
    start: int,
    stop: int,
    splats: Array,
    owners: Array,
    places: Array,
    moments: Array,
    d_means: Array,
    d_covariances: Array,
    d_opacities: Array,
    d_harmonics: Array,
    d_camera: Array,
) -> None:
    """Add what the splats ``start .. stop`` owe to the gradients of what they were projected from.

    Args:
        means: ``[N, 3]``.
        covariances: ``[N, 6]``, packed.
        harmonics: ``[N, K, 3]``.
        camera: ``[CAMERA]``.
        limits: As for :func:`project`.
        tables: As for :func:`harmonics_at`.
        start: The first splat.
        stop: One behind the last splat.
        splats: ``[n, SPLAT]``, nearest first.
        owners: ``[n]``: the Gaussian of a splat, ascending.
        places: ``[n]``: the row of that splat in ``splats`` and ``moments``.
        moments: ``[n, MOMENTS]``, as :mod:`anystyle.renderers._raster` sums them.
        d_means: ``[N, 3]``, added to.
        d_covariances: ``[N, 6]``, added to.
        d_opacities: ``[N]``, added to.
        d_harmonics: ``[N, K, 3]``, added to.
        d_camera: ``[CAMERA]``, added to.
    """
    r, t, origin = camera[:9], camera[9:12], camera[12:15]
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    width, height = limits[0], limits[1]
    low_u, high_u = -(cx + MARGIN * width) / fx, (width - cx + MARGIN * width) / fx
    low_v, high_v = -(cy + MARGIN * height) / fy, (height - cy + MARGIN * height) / fy
    count = harmonics.shape[1]
    basis, slopes = np.full(count, tables[0, 0, 0]), np.zeros((count, 3))
    a, b, p, q, da, db, ray = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(start, stop):
        g, s, w = owners[i], splats[places[i]], moments[places[i]]
        c, mean = covariances[g], means[g]
        z = r[6] * mean[0] + r[7] * mean[1] + r[8] * mean[2] + t[2]
        u = (r[0] * mean[0] + r[1] * mean[1] + r[2] * mean[2] + t[0]) / z
        v = (r[3] * mean[0] + r[4] * mean[1] + r[5] * mean[2] + t[1]) / z
        bu, bv = min(max(u, low_u), high_u), min(max(v, low_v), high_v)
        sx, sy = fx / z, fy / z

        # sigma = (xx dx² + 2 xy dx dy + yy dy²) / 2, with (dx, dy) from the splat to a pixel.
        xx, xy, yy = float(s[2]), float(s[3]), float(s[4])
        gx, gy = -(xx * w[5] + xy * w[6]), -(xy * w[5] + yy * w[6])
        # The gradient of a covariance is -K G K, with its inverse K and the gradient G of that.
        gxx, gxy, gyy = 0.5 * w[7], 0.5 * w[8], 0.5 * w[9]
        hxx = -(xx * xx * gxx + 2.0 * xx * xy * gxy + xy * xy * gyy)
        hxy = -(xx * xy * gxx + (xx * yy + xy * xy) * gxy + xy * yy * gyy)
        hyy = -(xy * xy * gxx + 2.0 * xy * yy * gxy + yy * yy * gyy)
        d_opacities[g] -= w[4] / s[5]

        # The covariance is A C Aᵀ plus the filter, where A has the rows a and b.
        for j in range(3):
            a[j] = sx * (r[j] - bu * r[6 + j])
            b[j] = sy * (r[3 + j] - bv * r[6 + j])
        p[0], q[0] = c[0] * a[0] + c[1] * a[1] + c[2] * a[2], c[0] * b[0] + c[1] * b[1] + c[2] * b[2]
        p[1], q[1] = c[1] * a[0] + c[3] * a[1] + c[4] * a[2], c[1] * b[0] + c[3] * b[1] + c[4] * b[2]
        p[2], q[2] = c[2] * a[0] + c[4] * a[1] + c[5] * a[2], c[2] * b[0] + c[4] * b[1] + c[5] * b[2]
        entry = 0
        for j in range(3):
            for k in range(j, 3):
                twice = 1.0 if j == k else 2.0
                both = hxx * a[j] * a[k] + hxy * (a[j] * b[k] + b[j] * a[k]) + hyy * b[j] * b[k]
                d_covariances[g, entry] += twice * both
                entry += 1
        dsx = dsy = dbu = dbv = 0.0
        for j in range(3):
            da[j] = 2.0 * (hxx * p[j] + hxy * q[j])
            db[j] = 2.0 * (hxy * p[j] + hyy * q[j])
            dsx += da[j] * (r[j] - bu * r[6 + j])
            dsy += db[j] * (r[3 + j] - bv * r[6 + j])
            dbu -= sx * da[j] * r[6 + j]
            dbv -= sy * db[j] * r[6 + j]
            d_camera[j] += sx * da[j]
            d_camera[3 + j] += sy * db[j]
            d_camera[6 + j] -= sx * bu * da[j] + sy * bv * db[j]

        du, dv = gx * fx, gy * fy
        dfx, dfy, dcx, dcy = gx * u + dsx / z, gy * v + dsy / z, gx, gy
        # A slope at the border of the frustum moves with the border, which is (a constant - cx) / fx.
        if bu == u:
            du += dbu
        else:
            dfx -= dbu * bu / fx
            dcx -= dbu / fx
        if bv == v:
            dv += dbv
        else:
            dfy -= dbv * bv / fy
            dcy -= dbv / fy
        d_camera[15] += dfx
        d_camera[16] += dfy
        d_camera[17] += dcx
        d_camera[18] += dcy
        dx, dy = du / z, dv / z
        dz = w[3] - (dsx * sx + dsy * sy + du * u + dv * v) / z
        for j in range(3):
            d_camera[j] += dx * mean[j]
            d_camera[3 + j] += dy * mean[j]
            d_camera[6 + j] += dz * mean[j]
            d_means[g, j] += r[j] * dx + r[3 + j] * dy + r[6 + j] * dz
        d_camera[9] += dx
        d_camera[10] += dy
        d_camera[11] += dz

        # A channel that was cut at 0 has no gradient; the splat holds it after the cut.
        red = float(w[0]) if s[6] > 0.0 else 0.0
        green = float(w[1]) if s[7] > 0.0 else 0.0
        blue = float(w[2]) if s[8] > 0.0 else 0.0
        if count == 1:
            d_harmonics[g, 0, 0] += basis[0] * red
            d_harmonics[g, 0, 1] += basis[0] * green
            d_harmonics[g, 0, 2] += basis[0] * blue
            continue
        for j in range(3):
            ray[j] = mean[j] - origin[j]
        norm = max(sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]), 1e-12)
        for j in range(3):
            ray[j] /= norm
        harmonics_slopes(ray[0], ray[1], ray[2], tables, basis, slopes)
        ex = ey = ez = 0.0
        for k in range(count):
            d_basis = red * harmonics[g, k, 0] + green * harmonics[g, k, 1] + blue * harmonics[g, k, 2]
            ex += d_basis * slopes[k, 0]
            ey += d_basis * slopes[k, 1]
            ez += d_basis * slopes[k, 2]
            d_harmonics[g, k, 0] += basis[k] * red
            d_harmonics[g, k, 1] += basis[k] * green
            d_harmonics[g, k, 2] += basis[k] * blue
        along = ex * ray[0] + ey * ray[1] + ez * ray[2]
        ex, ey, ez = (ex - along * ray[0]) / norm, (ey - along * ray[1]) / norm, (ez - along * ray[2]) / norm
        d_means[g, 0] += ex
        d_means[g, 1] += ey
        d_means[g, 2] += ez
        d_camera[12] -= ex
        d_camera[13] -= ey
        d_camera[14] -= ez
