#!/usr/bin/env bash
# Quaternions of norm 2, as files of Gaussians hold them (a network's raw outputs), to a matrix: four answers.
#
# kornia 0.9.0, pytransform3d 3.17.0, viser 1.1.1 and trimesh 5.2.0 normalise. pypose 0.9.5, gtsam 4.3.0 and spatialmath
# 1.1.18's base.q2r return a matrix that is no rotation and no scaled one: 1 - 2 (y² + z²) stays 1 along the axis and
# stretches across it (axes of length 1, 2.05, 2.05). roma 1.8.0's unitquat_to_rotmat scales by 4, the square of the
# norm. rowan 1.3.2 raises. No warning by any. The covariance R S S^T R^T of a Gaussian then has another shape.
# Halfway from the identity to -q, which is the same rotation as q, 30 degrees: 15 degrees by roma, kornia, trimesh,
# rowan, gtsam; -165, the long way round, by pytransform3d's quaternion_slerp and quaternionic 1.0.18's slerp.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 pytransform3d==3.17.0 viser==1.1.1 trimesh==5.2.0 \
    pypose==0.9.5 gtsam==4.3.0 spatialmath-python==1.1.18 roma==1.8.0 rowan==1.3.2 quaternionic==1.0.18
env/bin/python -W ignore - <<'PYTHON'
import math

import gtsam
import numpy as np
import pypose
import pytransform3d.rotations as rotations
import quaternionic
import roma
import rowan
import spatialmath.base
import torch
import trimesh
import viser.transforms
from kornia.geometry.conversions import quaternion_to_rotation_matrix
from kornia.geometry.quaternion import Quaternion

half = math.radians(15)
wxyz, identity = np.array([math.cos(half), 0, 0, math.sin(half)]), np.array([1.0, 0, 0, 0])


def tensor(array):
    return torch.tensor(array, dtype=torch.float64)


def xyzw(array):
    return tensor(np.roll(array, -1))


MATRIX = {
    "kornia": lambda q: quaternion_to_rotation_matrix(tensor(q)),
    "pytransform3d": rotations.matrix_from_quaternion,
    "viser": lambda q: viser.transforms.SO3(wxyz=q).as_matrix(),
    "trimesh": lambda q: trimesh.transformations.quaternion_matrix(q)[:3, :3],
    "pypose": lambda q: pypose.SO3(xyzw(q)).matrix(),
    "gtsam": lambda q: gtsam.Rot3.Quaternion(*q).matrix(),
    "spatialmath": spatialmath.base.q2r,
    "roma": lambda q: roma.unitquat_to_rotmat(xyzw(q)),
}
axes = {}
for name, matrix in MATRIX.items():
    once, twice = (np.asarray(matrix(norm * wxyz), dtype=float).reshape(3, 3) for norm in (1, 2))
    assert np.allclose(once @ once.T, np.eye(3), atol=1e-6), name
    axes[name] = np.linalg.svd(twice, compute_uv=False)
    print(f"{name:14} axes of the matrix of twice the quaternion: {axes[name].round(2)}")
for name in ("kornia", "pytransform3d", "viser", "trimesh"):
    assert np.allclose(axes[name], 1, atol=1e-6), name
for name in ("pypose", "gtsam", "spatialmath"):
    assert np.allclose(axes[name], [2.0532, 2.0532, 1], atol=1e-3), (name, axes[name])
assert np.allclose(axes["roma"], 4)
try:
    rowan.to_matrix(2 * wxyz)
except ValueError as error:
    print("rowan:", error)
else:
    raise AssertionError("rowan took it")

HALFWAY = {
    "roma": lambda q: roma.unitquat_to_rotmat(roma.unitquat_slerp(xyzw(identity), xyzw(q), tensor([0.5]))),
    "kornia": lambda q: Quaternion(tensor(identity)[None]).slerp(Quaternion(tensor(q)[None]), 0.5).matrix().detach(),
    "trimesh": lambda q: MATRIX["trimesh"](trimesh.transformations.quaternion_slerp(identity, q, 0.5)),
    "rowan": lambda q: rowan.to_matrix(rowan.interpolate.slerp(identity, q, 0.5)),
    "gtsam": lambda q: gtsam.Rot3().slerp(0.5, gtsam.Rot3.Quaternion(*q)).matrix(),
    "pytransform3d": lambda q: rotations.matrix_from_quaternion(rotations.quaternion_slerp(identity, q, 0.5)),
    "quaternionic": lambda q: quaternionic.slerp(
        quaternionic.array([identity]), quaternionic.array([q]), np.array([0.5])
    ).to_rotation_matrix,
}
for name, halfway in HALFWAY.items():
    found = np.asarray(halfway(-wxyz), dtype=float).reshape(3, 3)
    angle = math.degrees(math.atan2(found[1, 0], found[0, 0]))
    print(f"{name:14} halfway to -q: {angle:.0f} degrees")
    assert abs(angle - (-165 if name in ("pytransform3d", "quaternionic") else 15)) < 1e-3
PYTHON
echo "as described"
