#!/usr/bin/env bash
# pycpd 2.0.0: the rotation that it finds is for rows of points; used as others' are, it is off by twice the angle.
#
# 60 points, turned by 26 degrees, scaled by 1.3 and moved, aligned with what they came from. Angle between the rotation
# that is returned and the true one, and the largest distance after `scale * R @ point + t`:
#   pycpd RigidRegistration             52 degrees     3.1
#   pycpd AffineRegistration, B @ p + t    52 degrees     3.1
#   scikit-image 0.26.0, trimesh 5.2.0,           0              0.0
# `scale * point @ R + t` is right, and so is pycpd's own `transform_point_cloud`. The docstring says "DxD rotation
# matrix". t and the scale are those of others, and det R is 1, so that nothing shows it. No warning. Transpose R before
# cameras are moved with it, or take the points that `register` returns.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pycpd==2.0.0 scikit-image==0.26.0 trimesh==5.2.0 scipy==1.17.1 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import trimesh
from pycpd import AffineRegistration, RigidRegistration
from scipy.spatial.transform import Rotation
from skimage.transform import SimilarityTransform

random = np.random.default_rng(0)
points = random.normal(size=(60, 3))
true = Rotation.from_rotvec([0.1, 0.2, 0.4])
target = 1.3 * true.apply(points) + [0.1, 0.2, 0.3]


def tell(name, matrix, shift, angle, distance):
    scale = np.cbrt(np.linalg.det(matrix))
    found = np.degrees((Rotation.from_matrix(matrix / scale) * true.inv()).magnitude())
    missed = np.linalg.norm(points @ matrix.T + shift - target, axis=1).max()
    print(f"{name:30} {found:5.1f} degrees, scale {scale:.3f}, shift {np.round(shift, 3)}, missed by {missed:.2f}")
    assert abs(found - angle) < 0.1 and abs(missed - distance) < 0.05 and np.allclose(shift, [0.1, 0.2, 0.3], atol=1e-3)
    assert abs(scale - 1.3) < 1e-3


rigid = RigidRegistration(X=target, Y=points, max_iterations=300, tolerance=1e-10)
moved, (scale, rotation, shift) = rigid.register()
tell("pycpd, rigid, R @ point", scale * rotation, shift, 52.5, 3.07)
tell("pycpd, rigid, point @ R", scale * rotation.T, shift, 0, 0)
assert np.allclose(moved, target, atol=1e-4) and np.isclose(np.linalg.det(rotation), 1)
affine = AffineRegistration(X=target, Y=points, max_iterations=300, tolerance=1e-10)
moved, (matrix, shift) = affine.register()
tell("pycpd, affine, B @ point", matrix, shift, 52.5, 3.07)
tell("pycpd, affine, point @ B", matrix.T, shift, 0, 0)
similarity = SimilarityTransform.from_estimate(points, target)
tell("scikit-image", similarity.params[:3, :3], similarity.params[:3, 3], 0, 0)
matrix, _, _ = trimesh.registration.procrustes(points, target, reflection=False)
tell("trimesh", matrix[:3, :3], matrix[:3, 3], 0, 0)
PYTHON
echo "as described"
