#!/usr/bin/env bash
# A turn that is learnt from nothing, as where cameras are refined: at zero its gradient is NaN in JAX and two others.
#
# Three numbers, an axis times an angle, become a matrix M, at (0, 0, 0), where each refinement begins. The gradient of
# the sum of 1 to 9 times M's elements is (2, -4, 2) there:
#   JAX 0.10.2 jax.scipy.spatial.transform.Rotation.from_rotvec       NaN; and of `as_rotvec`, `magnitude`
#   pytorch-kinematics 0.10.0 axis_angle_to_quaternion               NaN; and of `matrix_to_axis_angle`
#   e3nn 0.6.0 axis_angle_to_quaternion, axis from `x / x.norm()`     NaN
#              axis_angle_to_matrix(x, x.norm())                      (0, 1.2e6, 0)
#   pytorch-kinematics so3_exp_map; kornia 0.9.0; roma 1.8.0; jaxlie 1.5.0; SciPy 1.17.1 Rotation on
#   PyTorch's tensors                                                 (2, -4, 2)
# All values are right: M is the identity. (JAX's is reported publicly.) The first step of Adam makes the turn NaN, and
# with it the picture. Nothing is said. The way back, as in a penalty on the angle between two poses that are equal
# still: roma's rotmat_geodesic_distance has a gradient of 0, and its `_naive` of NaN. Take one of the last row, or
# begin at 0.01.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6 scipy==1.17.1 setuptools==80.9.0 kornia==0.9.0 roma==1.8.0 \
    pytorch-kinematics==0.10.0 e3nn==0.6.0 jax==0.10.2 jaxlie==1.5.0
OMP_NUM_THREADS=1 SCIPY_ARRAY_API=1 JAX_PLATFORMS=cpu env/bin/python - <<'PYTHON'
import warnings

import jax
import jax.numpy as jnp
import jaxlie
import kornia
import numpy as np
import pytorch_kinematics.transforms as kinematics
import roma
import torch
from e3nn import o3
from jax.scipy.spatial.transform import Rotation as JaxRotation
from scipy.spatial.transform import Rotation

WEIGHTS = np.arange(1.0, 10).reshape(3, 3)


def e3nn_by_axis(x):
    length = x.norm(dim=-1, keepdim=True)
    return o3.quaternion_to_matrix(o3.axis_angle_to_quaternion(x / length, length[..., 0]))


by_torch = {
    "pytorch-kinematics, quaternion": lambda x: kinematics.quaternion_to_matrix(kinematics.axis_angle_to_quaternion(x)),
    "pytorch-kinematics so3_exp_map": kinematics.so3_exp_map,
    "e3nn axis_angle_to_quaternion": e3nn_by_axis,
    "e3nn axis_angle_to_matrix": lambda x: o3.axis_angle_to_matrix(x, x.norm(dim=-1)),
    "kornia": kornia.geometry.axis_angle_to_rotation_matrix,
    "roma": roma.rotvec_to_rotmat,
    "SciPy": lambda x: Rotation.from_rotvec(x).as_matrix(),
}
by_jax = {
    "JAX": lambda x: JaxRotation.from_rotvec(x).as_matrix(),
    "jaxlie": lambda x: jaxlie.SO3.exp(x).as_matrix(),
}


def gradient(name, start):
    if name in by_jax:
        there = jnp.full(3, start)
        return np.asarray(by_jax[name](there)), np.asarray(jax.grad(lambda x: (by_jax[name](x) * WEIGHTS).sum())(there))
    x = torch.full((1, 3), start, requires_grad=True)
    matrix = by_torch[name](x)[0]
    (slope,) = torch.autograd.grad((matrix * torch.tensor(WEIGHTS, dtype=torch.float32)).sum(), x)
    return matrix.detach().numpy(), slope[0].numpy()


bad = {"JAX", "pytorch-kinematics, quaternion", "e3nn axis_angle_to_quaternion", "e3nn axis_angle_to_matrix"}
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    found = {name: (gradient(name, 0.0), gradient(name, 0.01)) for name in (*by_jax, *by_torch)}
for name, ((value, slope), (_, beside)) in found.items():
    print(f"{name:31} at 0: {slope}, at 0.01: {np.round(beside, 2)}")
    assert np.allclose(beside, [1.94, -4, 2.06], atol=0.05)
    if name not in bad:
        assert np.allclose(value, np.eye(3), atol=1e-6) and np.allclose(slope, [2, -4, 2], atol=1e-3)
    elif name == "e3nn axis_angle_to_matrix":
        assert np.allclose(value, np.eye(3), atol=1e-6) and abs(slope).max() > 1e5
    else:
        assert np.isnan(slope).all()
assert np.array_equal(found["JAX"][0][0], np.eye(3))
print("warnings:", [str(each.message)[:80] for each in caught])

for name in ("as_rotvec", "magnitude"):
    slope = jax.grad(lambda x: jnp.sum(getattr(JaxRotation.from_rotvec(x), name)()))(jnp.zeros(3))
    print("JAX", name, slope)
    assert np.isnan(slope).all()

same = torch.eye(3)[None]
back = {
    "pytorch-kinematics matrix_to_axis_angle": lambda m: kinematics.matrix_to_axis_angle(m).sum(),
    "roma rotmat_to_rotvec": lambda m: roma.rotmat_to_rotvec(m).sum(),
    "roma geodesic": lambda m: roma.rotmat_geodesic_distance(m, same).sum(),
    "roma geodesic, naive": lambda m: roma.rotmat_geodesic_distance_naive(m, same).sum(),
}
slopes = {}
for name, function in back.items():
    matrix = same.clone().requires_grad_()
    slopes[name] = torch.autograd.grad(function(matrix), matrix)[0]
    print(f"{name}: {slopes[name].flatten().tolist()}")
assert slopes["pytorch-kinematics matrix_to_axis_angle"].isnan().any() and slopes["roma geodesic, naive"].isnan().any()
assert (slopes["roma geodesic"] == 0).all() and slopes["roma rotmat_to_rotvec"].isfinite().all()

turn = torch.zeros(1, 3, requires_grad=True)
optimiser = torch.optim.Adam([turn], 1e-3)
by_torch["pytorch-kinematics, quaternion"](turn)[0, 0, 1].backward()
optimiser.step()
print("after one step of Adam:", turn.tolist())
assert turn.isnan().all()
PYTHON
echo "as described"
