#!/usr/bin/env bash
# kornia 0.9.0 in bf16 autocast: points are projected up to 5 pixels off, and what comes out is said to be float32.
#
# PyTorch 2.13.0, `torch.autocast("cpu", torch.bfloat16)`, as within a training step or a validation in `bf16-mixed`;
# a camera of 1280 x 720 with f = 800, 4 units away from 2000 points in a cube of side 2. Differences from the same call
# outside of it:
#                                                          mean      largest   type
#   PinholeCamera.project                                  1.0       4.8 pixels      float32
#   PinholeCamera.unproject, of depth 4                    0.007     0.024 units     float32
#   geometry.transform_points                              0.003     0.017 units     float32
#   transform.warp_perspective by the identity, 64 x 64    a ramp of 0 to 63 changes by 0.96
#   camera.project_points; roma 1.8.0, RigidUnitQuat       0
# The products of matrices in them are rounded to eight bits, and then divided or added in float32. No warning. Call
# geometry in `torch.autocast(device_type, enabled=False)`.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 roma==1.8.0 numpy==2.4.6 setuptools==80.9.0
env/bin/python - <<'PYTHON'
import warnings

import kornia.geometry as geometry
import roma
import torch
from kornia.geometry.camera import PinholeCamera

lens = torch.eye(4)[None]
lens[0, :3, :3] = torch.tensor([[800.0, 0, 640], [0, 800, 360], [0, 0, 1]])
rotation, shift = roma.rotvec_to_rotmat(torch.tensor([0.1, 0.7, -0.2])), torch.tensor([0.3, -0.1, 4])
pose = torch.eye(4)[None]
pose[0, :3, :3], pose[0, :3, 3] = rotation, shift
camera = PinholeCamera(lens, pose, torch.tensor([720.0]), torch.tensor([1280.0]))
points = 2 * torch.rand(1, 2000, 3, generator=torch.Generator().manual_seed(0)) - 1
pixels = camera.project(points)
seen = points[0] @ rotation.T + shift
ramp = torch.arange(64.0).expand(1, 1, 64, 64)
turn = roma.RigidUnitQuat(roma.rotmat_to_unitquat(rotation), shift)
calls = {
    "PinholeCamera.project": lambda: camera.project(points),
    "PinholeCamera.unproject": lambda: camera.unproject(pixels, torch.full((1, 2000, 1), 4.0)),
    "transform_points": lambda: geometry.transform_points(pose, points),
    "warp_perspective": lambda: geometry.transform.warp_perspective(ramp, torch.eye(3)[None], (64, 64)),
    "project_points": lambda: geometry.camera.project_points(seen, lens[0, :3, :3].expand(2000, 3, 3)),
    "roma": lambda: turn.apply(points[0]),
}
found = {}
for name, call in calls.items():
    right = call()
    with warnings.catch_warnings(record=True) as caught, torch.autocast("cpu", torch.bfloat16):
        warnings.simplefilter("always")
        mixed = call()
    off = (mixed - right).abs()
    found[name] = off.mean().item(), off.max().item()
    print(f"{name:24} mean {found[name][0]:.4f}, largest {found[name][1]:.4f}, {mixed.dtype}, warnings {len(caught)}")
    assert mixed.dtype == torch.float32 and not caught
assert 0.5 < found["PinholeCamera.project"][0] < 2 and 3 < found["PinholeCamera.project"][1] < 8
assert 0.003 < found["PinholeCamera.unproject"][0] < 0.015 and found["PinholeCamera.unproject"][1] > 0.01
assert 0.001 < found["transform_points"][0] < 0.01 and found["transform_points"][1] > 0.008
assert 0.3 < found["warp_perspective"][1] < 2
assert max(found["project_points"] + found["roma"]) < 1e-3
PYTHON
echo "as described"
