"""Compiled kernels: covariances of Gaussians, packed as ``xx, xy, xz, yy, yz, zz``, and their gradients.

They follow :func:`anystyle.geometry.projection.covariances`, one Gaussian at a time in double precision.
Rotations are ``[N, 4]`` wxyz of any norm, scales ``[N, 3]`` standard deviations, packed covariances ``[N, 6]``.
"""

from math import sqrt

import numpy as np

from anystyle_cpu_renderer.compiled import compiled

Array = np.ndarray


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
def covariances(rotations: Array, scales: Array, start: int, stop: int, packed: Array) -> None:
    """Write the covariances ``start .. stop``."""
    r = np.empty((3, 3))
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
        row = packed[g]
        row[0], row[1], row[2], row[3], row[4], row[5] = xx, xy, xz, yy, yz, zz


@compiled
def covariances_backward(
    rotations: Array, scales: Array, start: int, stop: int, d_packed: Array, d_rotations: Array, d_scales: Array
) -> None:
    """Write the gradients of rotations and scales."""
    r, d_r = np.empty((3, 3)), np.empty((3, 3))
    for g in range(start, stop):
        d = d_packed[g]
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
