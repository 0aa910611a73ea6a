"""Compiled kernels: the backward pass of :mod:`anystyle_cpu_renderer.projection`, in its notation.

It starts from ``moments [n, MOMENTS]``, which :mod:`anystyle_cpu_renderer.raster` accumulates for each splat. ``d_x``
is the gradient of ``x`` in its shape, and is added to; that of the camera is left out unless ``posed``. ``lens`` holds
focal lengths over depth and slopes of the ray, ``fx / z, fy / z, u, v``; ``basis [K]``, ``slopes [K, 3]``, ``ray [3]``
are buffers; ``owners [n]`` are Gaussians, ascending, ``ranks [n]`` the rows of their splats in ``splats, moments``.
"""

from math import sqrt

import numpy as np

from anystyle_cpu_renderer.compiled import compiled
from anystyle_cpu_renderer.projection import MARGIN, harmonics_slopes

Array = np.ndarray


@compiled
def covariance_gradient(xx: float, xy: float, yy: float, gxx: float, gxy: float, gyy: float) -> tuple:
    """The gradient ``-K G K`` of a covariance, from the gradient G of its inverse K: xx, half of xy, yy."""
    hxx = -(xx * xx * gxx + 2.0 * xx * xy * gxy + xy * xy * gyy)
    hxy = -(xx * xy * gxx + (xx * yy + xy * xy) * gxy + xy * yy * gyy)
    hyy = -(xy * xy * gxx + 2.0 * xy * yy * gxy + yy * yy * gyy)
    return hxx, hxy, hyy


@compiled
def shape_backward(
    r: Array,
    covariances: Array,
    g: int,
    d_image: tuple,
    lens: tuple,
    d_covariances: Array,
    posed: bool,
    d_camera: Array,
) -> tuple:
    """Accumulate gradients of a covariance C and of the camera through the covariance ``A C Aᵀ`` in the image."""
    hxx, hxy, hyy = d_image
    sx, sy, bu, bv = lens
    # A has the rows a and b; p and q are their products with the covariance.
    c0, c1, c2 = covariances[g, 0], covariances[g, 1], covariances[g, 2]
    c3, c4, c5 = covariances[g, 3], covariances[g, 4], covariances[g, 5]
    a = sx * (r[0] - bu * r[6]), sx * (r[1] - bu * r[7]), sx * (r[2] - bu * r[8])
    b = sy * (r[3] - bv * r[6]), sy * (r[4] - bv * r[7]), sy * (r[5] - bv * r[8])
    p = c0 * a[0] + c1 * a[1] + c2 * a[2], c1 * a[0] + c3 * a[1] + c4 * a[2], c2 * a[0] + c4 * a[1] + c5 * a[2]
    q = c0 * b[0] + c1 * b[1] + c2 * b[2], c1 * b[0] + c3 * b[1] + c4 * b[2], c2 * b[0] + c4 * b[1] + c5 * b[2]
    entry = 0
    for j in range(3):
        for k in range(j, 3):
            twice = 1.0 if j == k else 2.0
            both = hxx * a[j] * a[k] + hxy * (a[j] * b[k] + b[j] * a[k]) + hyy * b[j] * b[k]
            d_covariances[g, entry] += twice * both
            entry += 1
    dsx = dsy = dbu = dbv = 0.0
    for j in range(3):
        da = 2.0 * (hxx * p[j] + hxy * q[j])
        db = 2.0 * (hxy * p[j] + hyy * q[j])
        dsx += da * (r[j] - bu * r[6 + j])
        dsy += db * (r[3 + j] - bv * r[6 + j])
        dbu -= sx * da * r[6 + j]
        dbv -= sy * db * r[6 + j]
        if posed:
            d_camera[j] += sx * da
            d_camera[3 + j] += sy * db
            d_camera[6 + j] -= sx * bu * da + sy * bv * db
    return dsx, dsy, dbu, dbv


@compiled
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
    """Accumulate gradients of view-dependent colour; that of the constant harmonic is added by the caller."""
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
def add_point(mean: Array, moved: tuple, lens: tuple, d_camera: Array) -> None:
    """Accumulate the gradient of the camera through one projected point."""
    for i in range(4):
        d_camera[15 + i] += lens[i]
    for i in range(3):
        for j in range(3):
            d_camera[3 * i + j] += moved[i] * float(mean[j])
        d_camera[9 + i] += moved[i]


@compiled
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
    ranks: Array,
    moments: Array,
    d_means: Array,
    d_covariances: Array,
    d_opacities: Array,
    d_harmonics: Array,
    posed: bool,
    d_camera: Array,
) -> None:
    """Accumulate gradients of Gaussians and of the camera through the splats ``start .. stop``."""
    r, t = camera[:9], camera[9:12]
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    width, height = limits[0], limits[1]
    low_u, high_u = -(cx + MARGIN * width) / fx, (width - cx + MARGIN * width) / fx
    low_v, high_v = -(cy + MARGIN * height) / fy, (height - cy + MARGIN * height) / fy
    count = harmonics.shape[1]
    basis, slopes = np.full(count, tables[0, 0, 0]), np.zeros((count, 3))
    ray = np.empty(3)
    for i in range(start, stop):
        g, at = owners[i], ranks[i]
        mx, my, mz = float(means[g, 0]), float(means[g, 1]), float(means[g, 2])
        z = r[6] * mx + r[7] * my + r[8] * mz + t[2]
        u = (r[0] * mx + r[1] * my + r[2] * mz + t[0]) / z
        v = (r[3] * mx + r[4] * my + r[5] * mz + t[1]) / z
        bu, bv = min(max(u, low_u), high_u), min(max(v, low_v), high_v)
        sx, sy = fx / z, fy / z

        # sigma = (xx dx² + 2 xy dx dy + yy dy²) / 2, with (dx, dy) from the splat to a pixel.
        xx, xy, yy = float(splats[at, 2]), float(splats[at, 3]), float(splats[at, 4])
        wx, wy = float(moments[at, 5]), float(moments[at, 6])
        gx, gy = -(xx * wx + xy * wy), -(xy * wx + yy * wy)
        h = covariance_gradient(xx, xy, yy, 0.5 * moments[at, 7], 0.5 * moments[at, 8], 0.5 * moments[at, 9])
        d_opacities[g] -= moments[at, 4] / splats[at, 5]

        lens = sx, sy, bu, bv
        dsx, dsy, dbu, dbv = shape_backward(r, covariances, g, h, lens, d_covariances, posed, d_camera)

        du, dv = gx * fx, gy * fy
        dfx, dfy, dcx, dcy = gx * u + dsx / z, gy * v + dsy / z, gx, gy
        # A slope clamped to the border of the frustum depends on the intrinsics: the border is (constant - cx) / fx.
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
        dx, dy = du / z, dv / z
        dz = moments[at, 3] - (dsx * sx + dsy * sy + du * u + dv * v) / z
        for j in range(3):
            d_means[g, j] += r[j] * dx + r[3 + j] * dy + r[6 + j] * dz
        if posed:
            add_point(means[g], (dx, dy, dz), (dfx, dfy, dcx, dcy), d_camera)

        # A channel that was clamped at 0 has no gradient; the splat stores the clamped value.
        red = float(moments[at, 0]) if splats[at, 6] > 0.0 else 0.0
        green = float(moments[at, 1]) if splats[at, 7] > 0.0 else 0.0
        blue = float(moments[at, 2]) if splats[at, 8] > 0.0 else 0.0
        d_harmonics[g, 0, 0] += basis[0] * red
        d_harmonics[g, 0, 1] += basis[0] * green
        d_harmonics[g, 0, 2] += basis[0] * blue
        if count > 1:
            color = red, green, blue
            view_backward(
                means[g], camera, harmonics[g], color, tables, basis, slopes, ray, d_means[g], d_harmonics[g], d_camera
            )
