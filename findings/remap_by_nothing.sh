#!/usr/bin/env bash
# kornia 0.9.0: `geometry.transform.remap` with the identity as its map of pixels changes the image.
#
# The map is brought to [-1, 1] as if the outer pixels' centres lay there (division by W - 1), and sampled as if their
# edges did (`align_corners` is None, which PyTorch takes for False). The picture is stretched about its middle by
# W / (W - 1): half a pixel off at its sides, whose outer pixels are blended with zeros. No warning. With
# `align_corners=True` it is the identity. OpenCV 5.0.0.93 and scikit-image 0.26.0 return the picture itself.
# Seen: a ramp whose values are their own columns, 32 of them.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 opencv-python-headless==5.0.0.93 scikit-image==0.26.0
env/bin/python -W error - <<'PYTHON'
import cv2
import numpy as np
import torch
from kornia.geometry.transform import remap
from skimage.transform import warp

HEIGHT, WIDTH = 24, 32
rows, columns = torch.meshgrid(torch.arange(float(HEIGHT)), torch.arange(float(WIDTH)), indexing="ij")
ramp = columns[None, None]


def row(image):
    return np.asarray(image, dtype=float).reshape(HEIGHT, WIDTH)[HEIGHT // 2]


default = row(remap(ramp, columns[None], rows[None]))
corners = row(remap(ramp, columns[None], rows[None], align_corners=True))
opencv = row(cv2.remap(columns.numpy(), columns.numpy(), rows.numpy(), cv2.INTER_LINEAR))
skimage = row(warp(columns.numpy(), np.stack([rows.numpy(), columns.numpy()]), preserve_range=True))
print("columns 1, 8, 16, 24, 30, 31 by default:", default[[1, 8, 16, 24, 30, 31]].round(2))
expected = (np.arange(WIDTH) - (WIDTH - 1) / 2) * WIDTH / (WIDTH - 1) + (WIDTH - 1) / 2
assert np.abs(default[1:-1] - expected[1:-1]).max() < 1e-4 and abs(default[1] - 1) > 0.4
assert abs(default[-1] - 15.5) < 1e-4  # half of 31
for same in (corners, opencv, skimage):
    assert np.abs(same - np.arange(WIDTH)).max() < 1e-4
PYTHON
echo "as described"
