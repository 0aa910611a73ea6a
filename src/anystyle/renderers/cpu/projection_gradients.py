"""Compiled kernels: the gradients of projection, from what the rasteriser sums for each splat.

The backward of :mod:`anystyle.renderers.cpu.projection`, in its notation.
"""

from math import sqrt
from typing import no_type_check

import numpy as np

from anystyle.renderers.cpu.compiled import compiled
from anystyle.renderers.cpu.projection import MARGIN, harmonics_slopes

Array = np.ndarray


@compiled
@no_type_check
def covariance_gradient(xx: float, xy: float, yy: float, gxx: float, gxy: float, gyy: float) -> tuple:
    """The gradient ``-K G K`` of a covariance, with its inverse K and the gradient G of that: xx, half of xy, yy."""
    hxx = -(xx * xx * gxx + 2.0 * xx * xy * gxy + xy * xy * gyy)
    hxy = -(xx * xy * gxx + (xx * yy + xy * xy) * gxy + xy * yy * gyy)
    hyy = -(xy * xy * gxx + 2.0 * xy * yy * gxy + yy * yy * gyy)
    return hxx, hxy, hyy


@compiled
@no_type_check
def shape_backward(
    r: Array, c: Array, d_image: tuple, lens: tuple, buffers: Array, d_covariance: Array, d_camera: Array
) -> tuple:
    """Add to the gradients of a covariance and of the camera what the covariance ``A C Aᵀ`` in the image owes.

    Args:
        r: ``[9]``: rows of the rotation from world.
        c: ``[6]``: the covariance in space, packed.
        d_image: Gradients of the covariance in the image: xx, half of xy, yy.
        lens: Focal lengths over depth and slopes of the ray: ``fx / z, fy / z, u, v``.
        buffers: ``[4, 3]``, overwritten.
        d_covariance: ``[6]``, added to.
        d_camera: ``[CAMERA]``, added to.

    Returns:
        Gradients of the four numbers of ``lens``.
    """
    hxx, hxy, hyy = d_image
    sx, sy, bu, bv = lens
    # A has the rows a and b; p and q are their products with the covariance.
    a, b, p, q = buffers[0], buffers[1], buffers[2], buffers[3]
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
            d_covariance[entry] += twice * both
            entry += 1
    dsx = dsy = dbu = dbv = 0.0
    for j in range(3):
        da = 2.0 * (hxx * p[j] + hxy * q[j])
        db = 2.0 * (hxy * p[j] + hyy * q[j])
        dsx += da * (r[j] - bu * r[6 + j])
        dsy += db * (r[3 + j] - bv * r[6 + j])
        dbu -= sx * da * r[6 + j]
        dbv -= sy * db * r[6 + j]
        d_camera[j] += sx * da
        d_camera[3 + j] += sy * db
        d_camera[6 + j] -= sx * bu * da + sy * bv * db
    return dsx, dsy, dbu, dbv


@compiled
@no_type_check
def color_backward(w: Array, s: Array, basis: Array, d_harmonics: Array) -> tuple:
    """Add what a splat's colour owes to its constant harmonic; the gradient of that colour before it is cut at 0.

    Args:
        w: ``[MOMENTS]``: sums of the splat.
        s: ``[SPLAT]``.
        basis: ``[K]``: of which the first value is constant.
        d_harmonics: ``[K, 3]``, added to.

    Returns:
        Gradients of red, green, blue.
    """
    # A channel that was cut at 0 has no gradient; the splat holds it after the cut.
    red = float(w[0]) if s[6] > 0.0 else 0.0
    green = float(w[1]) if s[7] > 0.0 else 0.0
    blue = float(w[2]) if s[8] > 0.0 else 0.0
    d_harmonics[0, 0] += basis[0] * red
    d_harmonics[0, 1] += basis[0] * green
    d_harmonics[0, 2] += basis[0] * blue
    return red, green, blue


@compiled
@no_type_check
def view_backward(
    mean: Array,
    camera: Array,
    harmonics: Array,
    d_color: tuple,
    tables: Array,
    basis: Array,
    slopes: Array,
    ray: Array,
    d_mean: Array,
    d_harmonics: Array,
    d_camera: Array,
) -> None:
    """Add what a colour owes that depends on the direction it is seen from, but for the constant harmonic.

    Args:
        mean: ``[3]``.
        camera: ``[CAMERA]``.
        harmonics: ``[K, 3]``.
        d_color: Gradients of red, green, blue.
        tables: As for :func:`~anystyle.renderers.cpu.projection.harmonics_at`.
        basis: ``[K]``, overwritten.
        slopes: ``[K, 3]``, overwritten.
        ray: ``[3]``, overwritten.
        d_mean: ``[3]``, added to.
        d_harmonics: ``[K, 3]``, added to.
        d_camera: ``[CAMERA]``, added to.
    """
    red, green, blue = d_color
    for j in range(3):
        ray[j] = mean[j] - camera[12 + j]
    norm = max(sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]), 1e-12)
    for j in range(3):
        ray[j] /= norm
    harmonics_slopes(ray[0], ray[1], ray[2], tables, basis, slopes)
    ex = ey = ez = 0.0
    for k in range(len(basis)):
        d_basis = red * harmonics[k, 0] + green * harmonics[k, 1] + blue * harmonics[k, 2]
        ex += d_basis * slopes[k, 0]
        ey += d_basis * slopes[k, 1]
        ez += d_basis * slopes[k, 2]
        if k > 0:
            d_harmonics[k, 0] += basis[k] * red
            d_harmonics[k, 1] += basis[k] * green
            d_harmonics[k, 2] += basis[k] * blue
    along = ex * ray[0] + ey * ray[1] + ez * ray[2]
    ex, ey, ez = (ex - along * ray[0]) / norm, (ey - along * ray[1]) / norm, (ez - along * ray[2]) / norm
    d_mean[0] += ex
    d_mean[1] += ey
    d_mean[2] += ez
    d_camera[12] -= ex
    d_camera[13] -= ey
    d_camera[14] -= ez


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
        moments: ``[n, MOMENTS]``, as :mod:`anystyle.renderers.cpu.raster` sums them.
        d_means: ``[N, 3]``, added to.
        d_covariances: ``[N, 6]``, added to.
        d_opacities: ``[N]``, added to.
        d_harmonics: ``[N, K, 3]``, added to.
        d_camera: ``[CAMERA]``, added to.
    """
    r, t = camera[:9], camera[9:12]
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    width, height = limits[0], limits[1]
    low_u, high_u = -(cx + MARGIN * width) / fx, (width - cx + MARGIN * width) / fx
    low_v, high_v = -(cy + MARGIN * height) / fy, (height - cy + MARGIN * height) / fy
    count = harmonics.shape[1]
    basis, slopes = np.full(count, tables[0, 0, 0]), np.zeros((count, 3))
    buffers, ray = np.empty((4, 3)), np.empty(3)
    for i in range(start, stop):
        g, s, w = owners[i], splats[places[i]], moments[places[i]]
        mean = means[g]
        z = r[6] * mean[0] + r[7] * mean[1] + r[8] * mean[2] + t[2]
        u = (r[0] * mean[0] + r[1] * mean[1] + r[2] * mean[2] + t[0]) / z
        v = (r[3] * mean[0] + r[4] * mean[1] + r[5] * mean[2] + t[1]) / z
        bu, bv = min(max(u, low_u), high_u), min(max(v, low_v), high_v)
        sx, sy = fx / z, fy / z

        # sigma = (xx dx² + 2 xy dx dy + yy dy²) / 2, with (dx, dy) from the splat to a pixel.
        xx, xy, yy = float(s[2]), float(s[3]), float(s[4])
        gx, gy = -(xx * w[5] + xy * w[6]), -(xy * w[5] + yy * w[6])
        h = covariance_gradient(xx, xy, yy, 0.5 * w[7], 0.5 * w[8], 0.5 * w[9])
        d_opacities[g] -= w[4] / s[5]

        dsx, dsy, dbu, dbv = shape_backward(r, covariances[g], h, (sx, sy, bu, bv), buffers, d_covariances[g], d_camera)

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

        red, green, blue = color_backward(w, s, basis, d_harmonics[g])
        if count > 1:
            color = red, green, blue
            view_backward(
                mean, camera, harmonics[g], color, tables, basis, slopes, ray, d_means[g], d_harmonics[g], d_camera
            )
