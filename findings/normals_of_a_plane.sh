#!/usr/bin/env bash
# Normals of a tilted plane from its depth: those of kornia look away from the camera, those of OpenCV towards it.
#
# 40 x 30 pixels, a focal length of 20; the plane's side that the camera sees has the normal (0.28, -0.19, -0.94), in
# axes x to the right, y down, z ahead:
#   kornia 0.9.0, depth_to_normals          (-0.28, 0.19, 0.94) everywhere
#   opencv 5.0.0.93, RgbdNormals, FALS      right everywhere
#          LINEMOD                          0.3 degrees off; NaN in 649 of 1200 pixels
#          SRI                              0.1 degrees off in the middle, but (0.26, -0.93, -0.26) in a corner
#          CROSS_PRODUCT                    right; NaN in the last row and column
# Of a hole, depth 0, kornia has normals of 0, and beside it ones that are 76 degrees off; OpenCV wants NaN there, has
# NaN, and by FALS 83 degrees beside it. No warning. Light from the camera on kornia's normals is black: turn them.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import cv2
import numpy as np
import torch
from kornia.geometry.depth import depth_to_normals

WIDTH, HEIGHT = 40, 30
camera = np.array([[20.0, 0, 20], [0, 20, 15], [0, 0, 1]])
true = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])
columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
rays = np.stack([(columns - 20) / 20, (rows - 15) / 20, np.ones((HEIGHT, WIDTH))], -1)
depth = -2 / (rays @ true)
hole = depth.copy()
hole[10:20, 10:20] = 0


def by_kornia(depth):
    found = depth_to_normals(torch.tensor(depth)[None, None], torch.tensor(camera)[None])
    return found[0].permute(1, 2, 0).numpy()


def by_opencv(depth, method):
    method = getattr(cv2, f"RgbdNormals_RGBD_NORMALS_METHOD_{method}")
    points = rays * np.where(depth > 0, depth, np.nan)[..., None]
    points = np.dstack([points, np.zeros_like(depth)]).astype(np.float32)
    return cv2.RgbdNormals_create(HEIGHT, WIDTH, cv2.CV_32F, camera, 5, 50.0, method).apply(points)[..., :3]


def degrees(found, normal):
    return np.rad2deg(np.arccos((found @ normal).clip(-1, 1)))


found = by_kornia(depth)
print("kornia", found[15, 20].round(2))
assert np.allclose(found, -true, atol=1e-6)
found = by_kornia(hole)
beside = degrees(found[12:18, 9], -true)
print("kornia, in the hole", found[15, 15], "beside it, degrees", beside.round())
assert (found[12:18, 12:18] == 0).all() and np.allclose(beside, 76, atol=1)
for method, middle in (("FALS", 0.1), ("LINEMOD", 0.35), ("SRI", 0.15), ("CROSS_PRODUCT", 0.1)):
    found = by_opencv(depth, method)
    off = degrees(found, true)
    print(f"{method:14} middle {found[15, 20].round(3)}, {off[15, 20]:.2f} degrees; corner {found[0, 0].round(2)},"
          f" {np.isnan(off).sum()} pixels NaN")
    assert off[15, 20] < middle and (method not in ("LINEMOD", "SRI") or off[15, 20] > 0.05)
    if method == "FALS":
        assert not np.isnan(off).any() and off.max() < 0.1
        beside = degrees(by_opencv(hole, method)[12:18, 9], true)
        print(f"{'':14} beside a hole, degrees {beside.round()}")
        assert np.allclose(beside, 83, atol=1) and np.isnan(by_opencv(hole, method)[15, 15]).all()
    elif method == "SRI":
        assert degrees(found[0, 0], true) > 40
    elif method == "LINEMOD":
        assert np.isnan(off).sum() == 649
    else:
        assert np.nanmax(off) < 0.1 and np.isnan(off).sum() == WIDTH + HEIGHT - 1
PYTHON
echo "as described"
