"""Compiled kernels: from Gaussians in space to splats in one image, and back for gradients.

They follow :func:`anystyle.geometry.projection.project` and :func:`anystyle.geometry.harmonics.colors`, one Gaussian
at a time in double precision. A splat is a row of 12 numbers, named by the constants below.
"""

from math import ceil, floor, isfinite, log, sqrt
from typing import no_type_check

import numpy as np

from anystyle.renderers._compiled import compiled

Array = np.ndarray

X, Y, XX, XY, YY, OPACITY, RED, GREEN, BLUE, DEPTH, REACH, TALL = range(12)
"""A splat: image position, conic, opacity, payload, ``ln(255 opacity)`` and half height of where it is seen."""

SPLAT = 12
MARGIN = 0.15
"""As :data:`anystyle.geometry.projection.FRUSTUM_MARGIN`."""


@compiled
@no_type_check
def harmonics_at(x: float, y: float, z: float, degree: int, scale: Array, values: Array, slopes: Array) -> None:
    """Harmonics at a unit vector and their derivatives along the axes (a smooth continuation off the sphere).

    Args:
        x, y, z: The unit vector.
        degree: The highest.
        scale: ``[degree + 1, degree + 1]`` normalisations of degree and order.
        values: ``[K]``, written.
        slopes: ``[K, 3]``, written.
    """
    cosine, sine = 1.0, 0.0
    cosine_below, sine_below = 0.0, 0.0
    diagonal = 1.0
    for m in range(degree + 1):
        p, dp, p_below, dp_below = diagonal, 0.0, 0.0, 0.0
        for l in range(m, degree + 1):
            if l > m:
                above = ((2 * l - 1) * z * p - (l + m - 1) * p_below) / (l - m)
                d_above = ((2 * l - 1) * (p + z * dp) - (l + m - 1) * dp_below) / (l - m)
                p, dp, p_below, dp_below = above, d_above, p, dp
            s = scale[l, m]
            k = l * l + l
            values[k + m] = s * p * cosine
            slopes[k + m, 0] = s * p * m * cosine_below
            slopes[k + m, 1] = -s * p * m * sine_below
            slopes[k + m, 2] = s * dp * cosine
            if m > 0:
                values[k - m] = s * p * sine
                slopes[k - m, 0] = s * p * m * sine_below
                slopes[k - m, 1] = s * p * m * cosine_below
                slopes[k - m, 2] = s * dp * sine
        cosine_below, sine_below = cosine, sine
        cosine, sine = x * cosine_below - y * sine_below, x * sine_below + y * cosine_below
        diagonal *= 2 * m + 1


@compiled
@no_type_check
def harmonics_values(x: float, y: float, z: float, degree: int, scale: Array, values: Array) -> None:
    """The values of :func:`harmonics_at` alone."""
    cosine, sine = 1.0, 0.0
    diagonal = 1.0
    for m in range(degree + 1):
        p, p_below = diagonal, 0.0
        for l in range(m, degree + 1):
            if l > m:
                p, p_below = ((2 * l - 1) * z * p - (l + m - 1) * p_below) / (l - m), p
            values[l * l + l + m] = scale[l, m] * p * cosine
            if m > 0:
                values[l * l + l - m] = scale[l, m] * p * sine
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
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
    scale: Array,
    width: int,
    height: int,
    start: int,
    stop: int,
    splats: Array,
    index: Array,
) -> int:
    """Write the splats of the Gaussians ``start .. stop`` that an image shows.

    Args:
        means: ``[N, 3]``.
        covariances: ``[N, 3, 3]``.
        opacities: ``[N]``.
        harmonics: ``[N, K, 3]``.
        camera: ``[19]``: rows of the rotation, the translation, the origin, fx, fy, cx, cy.
        limits: near, far, variance of the low-pass filter.
        scale: Normalisations of the harmonics.
        width, height: In pixels.
        start, stop: Which Gaussians; their splats are written from row ``start`` on.
        splats: ``[N, SPLAT]``, written.
        index: ``[N]``, written: the Gaussian of a splat.

    Returns:
        How many splats were written.
    """
    r, t, origin = camera[:9], camera[9:12], camera[12:15]
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    near, far, blur = limits[0], limits[1], limits[2]
    degree = scale.shape[0] - 1
    basis = np.empty((degree + 1) ** 2)
    basis[0] = scale[0, 0]
    written = start
    for g in range(start, stop):
        opacity = float(opacities[g])
        mx, my, mz = float(means[g, 0]), float(means[g, 1]), float(means[g, 2])
        z = r[6] * mx + r[7] * my + r[8] * mz + t[2]
        if not (opacity >= 1.0 / 255.0 and z >= near and z <= far):
            continue
        u = (r[0] * mx + r[1] * my + r[2] * mz + t[0]) / z
        v = (r[3] * mx + r[4] * my + r[5] * mz + t[1]) / z
        bu = min(max(u, -(cx / fx + MARGIN * width / fx)), (width - cx) / fx + MARGIN * width / fx)
        bv = min(max(v, -(cy / fy + MARGIN * height / fy)), (height - cy) / fy + MARGIN * height / fy)
        sx, sy = fx / z, fy / z
        a0, a1, a2 = sx * (r[0] - bu * r[6]), sx * (r[1] - bu * r[7]), sx * (r[2] - bu * r[8])
        b0, b1, b2 = sy * (r[3] - bv * r[6]), sy * (r[4] - bv * r[7]), sy * (r[5] - bv * r[8])
        c = covariances[g]
        xx = yy = blur
        xy = 0.0
        p0, p1, p2 = (
            c[0, 0] * a0 + c[0, 1] * a1 + c[0, 2] * a2,
            c[1, 0] * a0 + c[1, 1] * a1 + c[1, 2] * a2,
            c[2, 0] * a0 + c[2, 1] * a1 + c[2, 2] * a2,
        )
        xx += a0 * p0 + a1 * p1 + a2 * p2
        xy += b0 * p0 + b1 * p1 + b2 * p2
        p0, p1, p2 = (
            c[0, 0] * b0 + c[0, 1] * b1 + c[0, 2] * b2,
            c[1, 0] * b0 + c[1, 1] * b1 + c[1, 2] * b2,
            c[2, 0] * b0 + c[2, 1] * b1 + c[2, 2] * b2,
        )
        yy += b0 * p0 + b1 * p1 + b2 * p2
        determinant = xx * yy - xy * xy
        px, py = fx * u + cx, fy * v + cy
        reach = log(255.0 * opacity)
        wide, tall = sqrt(2.0 * reach * xx), sqrt(2.0 * reach * yy)
        # Written so that nan fails.
        if not (
            determinant > 0.0
            and isfinite(determinant)
            and px + wide > 0.0
            and px - wide < width
            and py + tall > 0.0
            and py - tall < height
        ):
            continue
        s = splats[written]
        s[0], s[1] = px, py
        s[2], s[3], s[4] = yy / determinant, -xy / determinant, xx / determinant
        s[5] = opacity
        s[9] = z
        s[10] = reach
        s[11] = tall
        if degree > 0:
            dx, dy, dz = mx - origin[0], my - origin[1], mz - origin[2]
            norm = max(sqrt(dx * dx + dy * dy + dz * dz), 1e-12)
            harmonics_values(dx / norm, dy / norm, dz / norm, degree, scale, basis)
        red = green = blue = 0.5
        for k in range(basis.shape[0]):
            red += basis[k] * harmonics[g, k, 0]
            green += basis[k] * harmonics[g, k, 1]
            blue += basis[k] * harmonics[g, k, 2]
        s[6], s[7], s[8] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
        index[written] = g
        written += 1
    return written - start


@compiled
@no_type_check
def nearest_first(depths: Array) -> Array:
    """Sort by depth, stable: a radix sort over the bits of positive floats, which grow with their values.

    Args:
        depths: ``[n]`` of float32, above 0.

    Returns:
        The places of ``depths``, nearest first.
    """
    n = depths.shape[0]
    keys = depths.view(np.uint32)
    source = np.arange(n).astype(np.int32)
    target = np.empty(n, np.int32)
    counts = np.empty(2048, np.int64)
    for shift in (0, 11, 22):
        counts[:] = 0
        for i in range(n):
            counts[(keys[i] >> np.uint32(shift)) & np.uint32(2047)] += 1
        total = 0
        for digit in range(2048):
            count = counts[digit]
            counts[digit] = total
            total += count
        for i in range(n):
            g = source[i]
            digit = (keys[g] >> np.uint32(shift)) & np.uint32(2047)
            target[counts[digit]] = g
            counts[digit] += 1
        source, target = target, source
    return source


@compiled
@no_type_check
def project_backward(
    means: Array,
    covariances: Array,
    harmonics: Array,
    camera: Array,
    scale: Array,
    width: int,
    height: int,
    start: int,
    stop: int,
    splats: Array,
    index: Array,
    moments: Array,
    d_means: Array,
    d_covariances: Array,
    d_opacities: Array,
    d_harmonics: Array,
    d_camera: Array,
) -> None:
    """Add what the splats ``start .. stop`` owe to the gradients of what they were projected from.

    Args:
        means, covariances, harmonics, camera, scale, width, height: As for :func:`project`.
        start, stop: Which splats; no two of them are of one Gaussian.
        splats: ``[n, SPLAT]``.
        index: ``[n]``.
        moments: ``[n, MOMENTS]`` as :mod:`anystyle.renderers._raster` sums them.
        d_means, d_covariances, d_opacities, d_harmonics: Gradients, added to.
        d_camera: ``[19]``, added to.
    """
    r, t, origin = camera[:9], camera[9:12], camera[12:15]
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    low_u, high_u = -(cx / fx + MARGIN * width / fx), (width - cx) / fx + MARGIN * width / fx
    low_v, high_v = -(cy / fy + MARGIN * height / fy), (height - cy) / fy + MARGIN * height / fy
    degree = scale.shape[0] - 1
    count = (degree + 1) ** 2
    basis, slopes = np.empty(count), np.zeros((count, 3))
    basis[0] = scale[0, 0]
    pa, pb, da, db, ray = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(start, stop):
        g, s, q = index[i], splats[i], moments[i]
        c = covariances[g]
        mean = means[g]
        x = r[0] * mean[0] + r[1] * mean[1] + r[2] * mean[2] + t[0]
        y = r[3] * mean[0] + r[4] * mean[1] + r[5] * mean[2] + t[1]
        z = r[6] * mean[0] + r[7] * mean[1] + r[8] * mean[2] + t[2]
        u, v = x / z, y / z
        bu, bv = min(max(u, low_u), high_u), min(max(v, low_v), high_v)
        sx, sy = fx / z, fy / z

        # sigma = (xx dx² + 2 xy dx dy + yy dy²) / 2, with (dx, dy) from the splat to a pixel.
        kxx, kxy, kyy = float(s[2]), float(s[3]), float(s[4])
        gx = -(kxx * q[5] + kxy * q[6])
        gy = -(kxy * q[5] + kyy * q[6])
        # The covariance's gradient is -K G K, where K is its inverse and G the gradient of that.
        gxx, gxy, gyy = 0.5 * q[7], 0.5 * q[8], 0.5 * q[9]
        hxx = -(kxx * kxx * gxx + 2.0 * kxx * kxy * gxy + kxy * kxy * gyy)
        hxy = -(kxx * kxy * gxx + (kxx * kyy + kxy * kxy) * gxy + kxy * kyy * gyy)
        hyy = -(kxy * kxy * gxx + 2.0 * kxy * kyy * gxy + kyy * kyy * gyy)
        d_opacities[g] -= q[4] / s[5]

        # Through the 2x3 Jacobian with rows a and b.
        dsx = dsy = dbu = dbv = 0.0
        for j in range(3):
            da[j] = sx * (r[j] - bu * r[6 + j])
            db[j] = sy * (r[3 + j] - bv * r[6 + j])
        for j in range(3):
            pa[j] = c[j, 0] * da[0] + c[j, 1] * da[1] + c[j, 2] * da[2]
            pb[j] = c[j, 0] * db[0] + c[j, 1] * db[1] + c[j, 2] * db[2]
            for k in range(3):
                d_covariances[g, j, k] += (
                    hxx * da[j] * da[k] + hxy * (da[j] * db[k] + db[j] * da[k]) + hyy * db[j] * db[k]
                )
        for j in range(3):
            da[j] = 2.0 * (hxx * pa[j] + hxy * pb[j])
            db[j] = 2.0 * (hxy * pa[j] + hyy * pb[j])
            dsx += da[j] * (r[j] - bu * r[6 + j])
            dsy += db[j] * (r[3 + j] - bv * r[6 + j])
            dbu -= sx * da[j] * r[6 + j]
            dbv -= sy * db[j] * r[6 + j]
            d_camera[j] += sx * da[j]
            d_camera[3 + j] += sy * db[j]
            d_camera[6 + j] -= sx * bu * da[j] + sy * bv * db[j]

        du, dv = gx * fx, gy * fy
        dfx, dfy, dcx, dcy = gx * u + dsx / z, gy * v + dsy / z, gx, gy
        if bu == u:
            du += dbu
        else:  # at a border that moves with the intrinsics: its slope is (constant - cx) / fx
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
        dz = q[3] - (dsx * sx + dsy * sy + du * u + dv * v) / z

        norm = 0.0
        for j in range(3):
            ray[j] = mean[j] - origin[j]
            norm += ray[j] * ray[j]
        norm = max(sqrt(norm), 1e-12)
        if degree > 0:
            harmonics_at(ray[0] / norm, ray[1] / norm, ray[2] / norm, degree, scale, basis, slopes)
        # No gradient where the colour was cut at 0; the splat holds it after the cut.
        red = q[0] if s[6] > 0.0 else 0.0
        green = q[1] if s[7] > 0.0 else 0.0
        blue = q[2] if s[8] > 0.0 else 0.0
        ex = ey = ez = 0.0
        for k in range(count):
            h = harmonics[g, k]
            d = red * h[0] + green * h[1] + blue * h[2]
            ex += d * slopes[k, 0]
            ey += d * slopes[k, 1]
            ez += d * slopes[k, 2]
            d_harmonics[g, k, 0] += basis[k] * red
            d_harmonics[g, k, 1] += basis[k] * green
            d_harmonics[g, k, 2] += basis[k] * blue
        along = (ex * ray[0] + ey * ray[1] + ez * ray[2]) / (norm * norm)
        ex, ey, ez = (ex - along * ray[0]) / norm, (ey - along * ray[1]) / norm, (ez - along * ray[2]) / norm
        d_camera[12] -= ex
        d_camera[13] -= ey
        d_camera[14] -= ez

        d_means[g, 0] += r[0] * dx + r[3] * dy + r[6] * dz + ex
        d_means[g, 1] += r[1] * dx + r[4] * dy + r[7] * dz + ey
        d_means[g, 2] += r[2] * dx + r[5] * dy + r[8] * dz + ez
        for j in range(3):
            d_camera[j] += dx * mean[j]
            d_camera[3 + j] += dy * mean[j]
            d_camera[6 + j] += dz * mean[j]
        d_camera[9] += dx
        d_camera[10] += dy
        d_camera[11] += dz
