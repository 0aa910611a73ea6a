#!/usr/bin/env bash
# pyrr 0.10.3: a rotation as a quaternion turns one way, as a matrix the other, and as Euler angles about another axis.
#
# The point (1, 0, 0) turned by 30 degrees about z, which is (0.866, 0.5, 0), by pyrr's own functions and operators:
#   quaternion.apply_to_vector, Quaternion * Vector3                            ( 0.866,  0.5, 0)
#   matrix33.create_from_z_rotation, Matrix33.from_z_rotation, .matrix33 of that Quaternion, Matrix33(Quaternion),
#   Matrix44.from_quaternion, each by apply_to_vector or *                      ( 0.866, -0.5, 0)
#   matrix33.create_from_axis_rotation about (0, 0, 1), by apply_to_vector      ( 0.866,  0.5, 0)
#   euler.create(yaw=30 degrees) by Quaternion.from_eulers                      ( 0.866,  0.5, 0)
#   euler.create(yaw=30 degrees) by Matrix44.from_eulers                        ( 0.866,  0, 0.5): a turn about y
# Quaternion.from_matrix inverts the error of .matrix33, so that a round trip shows nothing. `create_from_z_rotation`
# as an array is the usual matrix for columns, and pyrr multiplies rows from the left. No warning. Take
# quaternions alone, which agree with SciPy 1.17.1.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pyrr==0.10.3 scipy==1.17.1 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
from pyrr import Matrix33, Matrix44, Quaternion, Vector3, euler, matrix33, quaternion
from scipy.spatial.transform import Rotation

angle, point, vector = np.radians(30), np.array([1.0, 0, 0]), Vector3([1.0, 0, 0])
turn = Quaternion.from_z_rotation(angle)
yaw = euler.create(yaw=angle)
left, other, about_y = (0.866, 0.5, 0), (0.866, -0.5, 0), (0.866, 0, 0.5)
z = matrix33.create_from_z_rotation(angle)
about = matrix33.create_from_axis_rotation(np.array([0.0, 0, 1]), angle)
for name, found, expected in (
    ("SciPy", Rotation.from_rotvec([0, 0, angle]).apply(point), left),
    ("quaternion.apply_to_vector", quaternion.apply_to_vector(quaternion.create_from_z_rotation(angle), point), left),
    ("Quaternion * Vector3", turn * vector, left),
    ("matrix33, z, apply_to_vector", matrix33.apply_to_vector(z, point), other),
    ("matrix33, z, as columns", z @ point, left),
    ("Matrix33.from_z_rotation *", Matrix33.from_z_rotation(angle) * vector, other),
    ("Quaternion.matrix33 *", turn.matrix33 * vector, other),
    ("Matrix33(Quaternion) *", Matrix33(turn) * vector, other),
    ("Matrix44.from_quaternion *", Matrix44.from_quaternion(turn) * vector, other),
    ("matrix33, axis, apply_to_vector", matrix33.apply_to_vector(about, point), left),
    ("Quaternion.from_eulers *", Quaternion.from_eulers(yaw) * vector, left),
    ("Matrix44.from_eulers *", Matrix44.from_eulers(yaw) * vector, about_y),
    ("there and back", Quaternion.from_matrix(turn.matrix33) * vector, left),
):
    print(f"{name:32} {np.round(np.asarray(found, float), 3)}")
    assert np.allclose(np.asarray(found, float), expected, atol=1e-3), name
PYTHON
echo "as described"
