#!/usr/bin/env bash
# ahrs 0.4.0: half a turn, as from OpenGL's cameras to OpenCV's, has no axis, and by one method it is no turn at all.
#
# Matrices of half turns about x, diag(1, -1, -1), about (1, 1, 0), which swaps x and y, and about (1, 2, -2). Degrees
# between the matrix and what it becomes, each taken back to a matrix by SciPy 1.17.1:
#                                               x      (1, 1, 0)    (1, 2, -2)
#   ahrs, DCM.to_axisangle, axis times angle    180    180          any: the axis is 0, 0, 0, or not of length 1
#         to_quaternion("chiaverini")           180    180          0
#         to_quaternion("hughes")               0      0            any: signs are those of rounding errors
#         to_quaternion(), "itzhack", "sarabandi"    0 everywhere
#   SciPy, OpenCV 5.0.0.93 Rodrigues, pytransform3d 3.17.0, transforms3d 0.4.2, pyquaternion 0.9.9, spatialmath 1.1.18
#                                               0      0            0
# No warning. Of 179.9 degrees all are right, so that tests with random rotations find nothing. Take quaternions by the
# default method. numpy-quaternion 2024.0.13 is right here, but its `mean_rotor_in_chordal_metric` of q and -q, which
# are one rotation, is NaN; SciPy's mean is that rotation.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet ahrs==0.4.0 scipy==1.17.1 numpy==2.4.6 opencv-python-headless==5.0.0.93 \
    pytransform3d==3.17.0 transforms3d==0.4.2 pyquaternion==0.9.9 spatialmath-python==1.1.18 \
    numpy-quaternion==2024.0.13
env/bin/python -W error::UserWarning - <<'PYTHON'
import ahrs
import cv2
import numpy as np
import pyquaternion
import quaternion
import spatialmath.base
import transforms3d
from pytransform3d.rotations import compact_axis_angle_from_matrix
from scipy.spatial.transform import Rotation


def of_quaternion(q):
    w, *xyz = np.asarray(q, float)
    return Rotation.from_quat([*xyz, w])


def axis_angle(matrix):
    axis, angle = ahrs.DCM(matrix).to_axisangle()
    return Rotation.from_rotvec(np.asarray(axis) * angle)


def quaternion_by(*method):
    return lambda matrix: of_quaternion(ahrs.DCM(matrix).to_quaternion(*method))


def by_transforms3d(matrix):
    axis, angle = transforms3d.axangles.mat2axangle(matrix)
    return Rotation.from_rotvec(axis * angle)


right = (0, 0, 0)
ways = {
    "ahrs to_axisangle": (axis_angle, (180, 180, np.nan)),
    "ahrs chiaverini": (quaternion_by("chiaverini"), (180, 180, 0)),
    "ahrs hughes": (quaternion_by("hughes"), (0, 0, np.nan)),
    "ahrs to_quaternion()": (quaternion_by(), right),
    "ahrs itzhack": (quaternion_by("itzhack"), right),
    "ahrs sarabandi": (quaternion_by("sarabandi"), right),
    "scipy": (lambda matrix: Rotation.from_rotvec(Rotation.from_matrix(matrix).as_rotvec()), right),
    "opencv": (lambda matrix: Rotation.from_rotvec(cv2.Rodrigues(matrix)[0][:, 0]), right),
    "pytransform3d": (lambda matrix: Rotation.from_rotvec(compact_axis_angle_from_matrix(matrix)), right),
    "transforms3d": (by_transforms3d, right),
    "pyquaternion": (lambda matrix: of_quaternion(pyquaternion.Quaternion(matrix=matrix).elements), right),
    "spatialmath": (lambda matrix: Rotation.from_rotvec(spatialmath.base.trlog(matrix, twist=True)), right),
    "numpy-quaternion": (
        lambda matrix: of_quaternion(quaternion.as_float_array(quaternion.from_rotation_matrix(matrix))), right),
}


def turn(axis, degrees):
    axis = np.array(axis, float)
    return Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()


half = np.diag([1.0, -1, -1]), np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), turn([1, 2, -2], 180)
nearly = [turn(axis, 179.9) for axis in ([1, 0, 0], [1, 1, 0], [1, 2, -2])]
for name, (way, expected) in ways.items():
    errors = [np.degrees((way(matrix) * Rotation.from_matrix(matrix).inv()).magnitude()) for matrix in half]
    others = [np.degrees((way(matrix) * Rotation.from_matrix(matrix).inv()).magnitude()) for matrix in nearly]
    print(f"{name:21} half a turn: {np.round(errors).astype(int)}; of 179.9 degrees: {np.round(others, 2)}")
    asked = ~np.isnan(expected)
    assert np.allclose(np.array(errors)[asked], np.array(expected)[asked], atol=1) and max(others) < 0.01

q = Rotation.from_rotvec([0.1, 0.5, -0.3])
both = np.array([q.as_quat(scalar_first=True), -q.as_quat(scalar_first=True)])
mean = quaternion.mean_rotor_in_chordal_metric(quaternion.as_quat_array(both))
print("mean of q and -q:", mean, Rotation.from_quat(both, scalar_first=True).mean().as_rotvec())
assert np.isnan(quaternion.as_float_array(mean)).all()
assert np.allclose(Rotation.from_quat(both, scalar_first=True).mean().as_rotvec(), [0.1, 0.5, -0.3])
PYTHON
echo "as described"
