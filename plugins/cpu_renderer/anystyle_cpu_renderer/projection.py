"""Compiled kernels: the projection of Gaussians to splats in one image, and its backward pass.

They follow :mod:`anystyle.geometry.projection` and :func:`anystyle.geometry.harmonics.colors`, one Gaussian at a time
in double precision. A splat is a row of 16 numbers, one cache line; constants name the columns.

The backward pass starts from ``moments [n, MOMENTS]``, which :mod:`anystyle_cpu_renderer.raster` accumulates for each
splat. ``into`` and ``d_x`` are gradients, and are added to; that of the camera is left out unless ``posed``. ``lens``
holds focal lengths over depth and slopes of the ray, ``fx / z, fy / z, u, v``; ``basis [K]``, ``slopes [K, 3]``, ``ray
[3]`` are buffers.
"""

from math import isfinite, log, sqrt
from typing import NamedTuple

import numpy as np

from anystyle_cpu_renderer.raster import SortedSplats, compiled

Array = np.ndarray


class SceneArrays(NamedTuple):
    """Gaussians of one scene, or their gradients; ``shapes [N, 6]`` are covariances: ``xx, xy, xz, yy, yz, zz``."""

    means: Array
    rotations: Array
    scales: Array
    opacities: Array
    harmonics: Array
    shapes: Array


LIMITS = ("width", "height", "near", "far", "eps2d", "antialiased")
"""What is the same for all views; the last is 1 where opacities are lowered by what the filter ``eps2d`` adds, or 0."""


class CameraArrays(NamedTuple):
    """One camera: see :data:`CAMERA`; :data:`LIMITS`; tables of :func:`harmonics_slopes`."""

    camera: Array
    limits: Array
    tables: Array


@compiled
def unit(quaternion: Array) -> tuple[float, float, float, float, float]:
    """The normalised quaternion wxyz, and its norm, clamped above 0."""
    w, x, y, z = float(quaternion[0]), float(quaternion[1]), float(quaternion[2]), float(quaternion[3])
    norm = max(sqrt(w * w + x * x + y * y + z * z), 1e-12)
    return w / norm, x / norm, y / norm, z / norm, norm


@compiled
def matrix(w: float, x: float, y: float, z: float, rotation: Array) -> None:
    """Write the rotation matrix ``[3, 3]`` of a unit quaternion."""
    rotation[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    rotation[0, 1] = 2.0 * (x * y - w * z)
    rotation[0, 2] = 2.0 * (x * z + w * y)
    rotation[1, 0] = 2.0 * (x * y + w * z)
    rotation[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    rotation[1, 2] = 2.0 * (y * z - w * x)
    rotation[2, 0] = 2.0 * (x * z - w * y)
    rotation[2, 1] = 2.0 * (y * z + w * x)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@compiled
def covariances(scene: SceneArrays, start: int, stop: int) -> None:
    """Write the covariances ``start .. stop``."""
    rotations, scales, r = scene.rotations, scene.scales, np.empty((3, 3))
    for g in range(start, stop):
        w, x, y, z, _ = unit(rotations[g])
        matrix(w, x, y, z, r)
        xx = xy = xz = yy = yz = zz = 0.0
        for k in range(3):
            variance = float(scales[g, k]) * float(scales[g, k])
            xx += variance * r[0, k] * r[0, k]
            xy += variance * r[0, k] * r[1, k]
            xz += variance * r[0, k] * r[2, k]
            yy += variance * r[1, k] * r[1, k]
            yz += variance * r[1, k] * r[2, k]
            zz += variance * r[2, k] * r[2, k]
        row = scene.shapes[g]
        row[0], row[1], row[2], row[3], row[4], row[5] = xx, xy, xz, yy, yz, zz


@compiled
def covariances_backward(scene: SceneArrays, start: int, stop: int, into: SceneArrays) -> None:
    """Write the gradients of rotations and scales."""
    rotations, scales, d_rotations, d_scales = scene.rotations, scene.scales, into.rotations, into.scales
    r, d_r = np.empty((3, 3)), np.empty((3, 3))
    for g in range(start, stop):
        d = into.shapes[g]
        if d[0] == 0.0 and d[1] == 0.0 and d[2] == 0.0 and d[3] == 0.0 and d[4] == 0.0 and d[5] == 0.0:
            d_rotations[g], d_scales[g] = 0.0, 0.0
            continue
        w, x, y, z, norm = unit(rotations[g])
        matrix(w, x, y, z, r)
        # Twice the symmetric gradient: a packed entry off the diagonal stands for two of the matrix.
        xx, xy, xz, yy, yz, zz = 2.0 * d[0], float(d[1]), float(d[2]), 2.0 * d[3], float(d[4]), 2.0 * d[5]
        for k in range(3):
            scale = float(scales[g, k])
            a = xx * r[0, k] + xy * r[1, k] + xz * r[2, k]
            b = xy * r[0, k] + yy * r[1, k] + yz * r[2, k]
            c = xz * r[0, k] + yz * r[1, k] + zz * r[2, k]
            d_scales[g, k] = scale * (a * r[0, k] + b * r[1, k] + c * r[2, k])
            d_r[0, k], d_r[1, k], d_r[2, k] = scale * scale * a, scale * scale * b, scale * scale * c
        turn_x, turn_y, turn_z = d_r[2, 1] - d_r[1, 2], d_r[0, 2] - d_r[2, 0], d_r[1, 0] - d_r[0, 1]
        sum_yz, sum_xz, sum_xy = d_r[2, 1] + d_r[1, 2], d_r[0, 2] + d_r[2, 0], d_r[1, 0] + d_r[0, 1]
        dw = 2.0 * (x * turn_x + y * turn_y + z * turn_z)
        dx = 2.0 * (w * turn_x + y * sum_xy + z * sum_xz - 2.0 * x * (d_r[1, 1] + d_r[2, 2]))
        dy = 2.0 * (w * turn_y + x * sum_xy + z * sum_yz - 2.0 * y * (d_r[0, 0] + d_r[2, 2]))
        dz = 2.0 * (w * turn_z + x * sum_xz + y * sum_yz - 2.0 * z * (d_r[0, 0] + d_r[1, 1]))
        along = w * dw + x * dx + y * dy + z * dz
        d_rotations[g, 0] = (dw - along * w) / norm
        d_rotations[g, 1] = (dx - along * x) / norm
        d_rotations[g, 2] = (dy - along * y) / norm
        d_rotations[g, 3] = (dz - along * z) / norm


X, Y, XX, XY, YY, OPACITY, RED, GREEN, BLUE, DEPTH, WIDE, TALL, PEAK, LEAN, BEND = range(15)
"""A splat: image position, conic, opacity, colour and depth, and the ellipse in which alpha is at least 1/255: its half
extents, the column of its highest point, and its rows at a distance ``dx`` from the centre, ``LEAN dx ± BEND sqrt(WIDE²
- dx²)``."""

CAMERA = 19
"""A camera: the rows of the rotation (9) and the translation (3) from world, its origin (3), fx, fy, cx, cy."""

MARGIN = 0.15
"""As :data:`anystyle.geometry.projection.FRUSTUM_MARGIN`."""


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
def frustum(camera: Array, limits: Array) -> tuple:
    """The least and the largest slope in x and in y at which the projection is linearised."""
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    wide, tall = MARGIN * limits[0], MARGIN * limits[1]
    return -(cx + wide) / fx, (limits[0] - cx + wide) / fx, -(cy + tall) / fy, (limits[1] - cy + tall) / fy


@compiled
def image_axes(r: Array, lens: tuple) -> tuple:
    """The rows of the matrix A that takes a covariance C to ``A C Aᵀ`` in the image."""
    sx, sy, bu, bv = lens
    a = sx * (r[0] - bu * r[6]), sx * (r[1] - bu * r[7]), sx * (r[2] - bu * r[8])
    b = sy * (r[3] - bv * r[6]), sy * (r[4] - bv * r[7]), sy * (r[5] - bv * r[8])
    return a, b


@compiled
def times(covariances: Array, g: int, a: tuple) -> tuple:
    """The product of a packed covariance and a vector."""
    xx, xy, xz = covariances[g, 0], covariances[g, 1], covariances[g, 2]
    yy, yz, zz = covariances[g, 3], covariances[g, 4], covariances[g, 5]
    x, y, z = a
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@compiled
def project(scene: SceneArrays, view: CameraArrays, start: int, stop: int, splats: Array, owners: Array) -> int:
    """Write the splats of the Gaussians ``start .. stop`` that are visible in an image."""
    means, _, _, opacities, harmonics, covariances = scene
    camera, limits, tables = view
    r, t, origin = camera[:9], camera[9:12], camera[12:15]
    fx, fy, cx, cy = camera[15], camera[16], camera[17], camera[18]
    width, height, near, far, blur = limits[0], limits[1], limits[2], limits[3], limits[4]
    low_u, high_u, low_v, high_v = frustum(camera, limits)
    count = harmonics.shape[1]
    basis, slopes = np.full(count, tables[0, 0, 0]), np.zeros((count, 3))
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
        a, b = image_axes(r, (sx, sy, bu, bv))
        p, q = times(covariances, g, a), times(covariances, g, b)
        xx = a[0] * p[0] + a[1] * p[1] + a[2] * p[2] + blur
        xy = b[0] * p[0] + b[1] * p[1] + b[2] * p[2]
        yy = b[0] * q[0] + b[1] * q[1] + b[2] * q[2] + blur
        determinant = xx * yy - xy * xy
        if limits[5] > 0.0 and determinant > 0.0:
            opacity *= sqrt(max((xx - blur) * (yy - blur) - xy * xy, 0.0) / determinant)
            if not opacity >= 1.0 / 255.0:
                continue
        px, py = fx * u + cx, fy * v + cy
        # The ellipse in which alpha is at least 1/255.
        reach = 2.0 * log(255.0 * opacity)
        wide, tall = sqrt(reach * xx), sqrt(reach * yy)
        seen = px + wide > 0.0 and px - wide < width and py + tall > 0.0 and py - tall < height
        if not (seen and determinant > 0.0 and isfinite(determinant)):
            continue
        s = splats[written]
        s[X], s[Y], s[OPACITY], s[DEPTH], s[WIDE], s[TALL] = px, py, opacity, z, wide, tall
        s[XX], s[XY], s[YY] = yy / determinant, -xy / determinant, xx / determinant
        s[PEAK], s[LEAN], s[BEND] = xy * sqrt(reach / yy), xy / xx, sqrt(determinant) / xx
        if count > 1:
            dx, dy, dz = mx - origin[0], my - origin[1], mz - origin[2]
            norm = max(sqrt(dx * dx + dy * dy + dz * dz), 1e-12)
            harmonics_slopes(dx / norm, dy / norm, dz / norm, tables, basis, slopes)
        red = green = blue = 0.5
        for k in range(count):
            red += basis[k] * harmonics[g, k, 0]
            green += basis[k] * harmonics[g, k, 1]
            blue += basis[k] * harmonics[g, k, 2]
        s[RED], s[GREEN], s[BLUE] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
        owners[written] = g
        written += 1
    return written - start


@compiled
def covariance_gradient(xx: float, xy: float, yy: float, gxx: float, gxy: float, gyy: float) -> tuple:
    """The gradient ``-K G K`` of a covariance, from the gradient G of its inverse K: xx, half of xy, yy."""
    hxx = -(xx * xx * gxx + 2.0 * xx * xy * gxy + xy * xy * gyy)
    hxy = -(xx * xy * gxx + (xx * yy + xy * xy) * gxy + xy * yy * gyy)
    hyy = -(xy * xy * gxx + 2.0 * xy * yy * gxy + yy * yy * gyy)
    return hxx, hxy, hyy


@compiled
def share_gradient(xx: float, xy: float, yy: float, blur: float) -> tuple:
    """The gradient of ``log(det S / det(S + blur I)) / 2``: xx, half of xy, yy."""
    sharp, wide = xx * yy - xy * xy, (xx + blur) * (yy + blur) - xy * xy
    return (
        0.5 * (yy / sharp - (yy + blur) / wide),
        -0.5 * (xy / sharp - xy / wide),
        0.5 * (xx / sharp - (xx + blur) / wide),
    )


@compiled
def shape_backward(
    r: Array,
    scene: SceneArrays,
    g: int,
    d_image: tuple,
    faded: tuple,
    lens: tuple,
    into: SceneArrays,
    posed: bool,
    d_camera: Array,
) -> tuple:
    """Accumulate gradients of a covariance C and of the camera through the covariance ``A C Aᵀ`` in the image.

    ``faded`` are the gradient of the logarithm of an opacity that depends on the covariance, or 0, and the blur.
    """
    hxx, hxy, hyy = d_image
    sx, sy, bu, bv = lens
    a, b = image_axes(r, lens)
    p, q = times(scene.shapes, g, a), times(scene.shapes, g, b)
    if faded[0] != 0.0:
        xx, xy = a[0] * p[0] + a[1] * p[1] + a[2] * p[2], b[0] * p[0] + b[1] * p[1] + b[2] * p[2]
        dxx, dxy, dyy = share_gradient(xx, xy, b[0] * q[0] + b[1] * q[1] + b[2] * q[2], faded[1])
        hxx, hxy, hyy = hxx + faded[0] * dxx, hxy + faded[0] * dxy, hyy + faded[0] * dyy
    entry = 0
    for j in range(3):
        for k in range(j, 3):
            twice = 1.0 if j == k else 2.0
            both = hxx * a[j] * a[k] + hxy * (a[j] * b[k] + b[j] * a[k]) + hyy * b[j] * b[k]
            into.shapes[g, entry] += twice * both
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
    scene: SceneArrays, view: CameraArrays, g: int, d_color: tuple, buffers: tuple, into: SceneArrays, d_camera: Array
) -> None:
    """Accumulate gradients of view-dependent colour; that of the constant harmonic is added by the caller."""
    red, green, blue = d_color
    basis, slopes, ray = buffers
    harmonics, d_mean, d_harmonics = scene.harmonics[g], into.means[g], into.harmonics[g]
    for j in range(3):
        ray[j] = scene.means[g, j] - view.camera[12 + j]
    norm = max(sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]), 1e-12)
    for j in range(3):
        ray[j] /= norm
    harmonics_slopes(ray[0], ray[1], ray[2], view.tables, basis, slopes)
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
    scene: SceneArrays,
    view: CameraArrays,
    start: int,
    stop: int,
    sorted_splats: SortedSplats,
    moments: Array,
    into: SceneArrays,
    shaped: bool,
    posed: bool,
    d_camera: Array,
) -> None:
    """Accumulate gradients of Gaussians and of the camera through the splats ``start .. stop``.

    Unless ``shaped``, only those that colours have.
    """
    means, harmonics, d_means, d_harmonics = scene.means, scene.harmonics, into.means, into.harmonics
    camera, limits, tables = view
    splats, owners, rows = sorted_splats.data, sorted_splats.owners, sorted_splats.rows
    r, t = camera[:9], camera[9:12]
    fx, fy = camera[15], camera[16]
    low_u, high_u, low_v, high_v = frustum(camera, limits)
    count = harmonics.shape[1]
    basis, slopes = np.full(count, tables[0, 0, 0]), np.zeros((count, 3))
    buffers = basis, slopes, np.empty(3)
    for i in range(start, stop):
        at = rows[i]
        g = owners[at]
        # A channel that was clamped at 0 has no gradient; the splat stores the clamped value.
        red = float(moments[at, 0]) if splats[at, RED] > 0.0 else 0.0
        green = float(moments[at, 1]) if splats[at, GREEN] > 0.0 else 0.0
        blue = float(moments[at, 2]) if splats[at, BLUE] > 0.0 else 0.0
        d_harmonics[g, 0, 0] += basis[0] * red
        d_harmonics[g, 0, 1] += basis[0] * green
        d_harmonics[g, 0, 2] += basis[0] * blue
        if count > 1:
            view_backward(scene, view, g, (red, green, blue), buffers, into, d_camera)
        if not shaped:
            continue

        mx, my, mz = float(means[g, 0]), float(means[g, 1]), float(means[g, 2])
        z = r[6] * mx + r[7] * my + r[8] * mz + t[2]
        u = (r[0] * mx + r[1] * my + r[2] * mz + t[0]) / z
        v = (r[3] * mx + r[4] * my + r[5] * mz + t[1]) / z
        bu, bv = min(max(u, low_u), high_u), min(max(v, low_v), high_v)
        sx, sy = fx / z, fy / z

        # sigma = (xx dx² + 2 xy dx dy + yy dy²) / 2, with (dx, dy) from the splat to a pixel.
        xx, xy, yy = float(splats[at, XX]), float(splats[at, XY]), float(splats[at, YY])
        wx, wy = float(moments[at, 5]), float(moments[at, 6])
        gx, gy = -(xx * wx + xy * wy), -(xy * wx + yy * wy)
        h = covariance_gradient(xx, xy, yy, 0.5 * moments[at, 7], 0.5 * moments[at, 8], 0.5 * moments[at, 9])
        into.opacities[g] -= moments[at, 4] / scene.opacities[g]
        faded = -float(moments[at, 4]) * limits[5], limits[4]

        lens = sx, sy, bu, bv
        dsx, dsy, dbu, dbv = shape_backward(r, scene, g, h, faded, lens, into, posed, d_camera)

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
