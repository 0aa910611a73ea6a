#!/usr/bin/env bash
# kornia 0.9.0: one object of a mask, 280 pixels wide, is 32400 objects, and distances from it are those along the axes.
#
# `kornia.contrib` on masks of floats of 0 and 1, by default:
#   connected_components, a square of       101      110      150      280 pixels
#     objects that it finds                 1        100      2500     32400
#     with num_iterations=300               1        1        1        1
#   distance_transform from one pixel, to the middle of a side, 50 away                 49.8
#     to the corner, 70.7 away                                                          50.4
#     to the corner, kernel_size=11, 31                                                 52.1, 52.0
#   SciPy 1.17.1 `label`, `distance_transform_edt`                                      1 object, 50, 70.7
# A label moves on by one pixel a round, for 100 rounds, and pixels that it does not reach keep labels of their own: an
# object is whole if no path in it is longer than that. No warning. The documentation names the rounds, and says that
# distances are approximate, not that they are 29 % short along a diagonal. Guessed: a few objects, and some percent.
# Pass as many rounds as the longest path has pixels, or use SciPy.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 scipy==1.17.1 numpy==2.4.6 setuptools==80.9.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import torch
from kornia.contrib import connected_components, distance_transform
from scipy import ndimage


def objects(labels):
    return len(np.unique(labels[labels > 0]))


for side, expected in ((101, 1), (110, 100), (150, 2500), (280, 32400)):
    mask = torch.zeros(1, 1, 300, 300)
    mask[..., 10:10 + side, 10:10 + side] = 1
    found = objects(connected_components(mask).numpy())
    longer = objects(connected_components(mask, num_iterations=300).numpy())
    by_scipy = ndimage.label(mask[0, 0].numpy())[1]
    print(f"a square of {side}: {found} objects, {longer} with 300 rounds, {by_scipy} by SciPy")
    assert (found, longer, by_scipy) == (expected, 1, 1)

mask = torch.zeros(1, 1, 101, 101)
mask[..., 50, 50] = 1
exact = ndimage.distance_transform_edt(mask[0, 0].numpy() == 0)
print(f"SciPy: side {exact[50, 100]:.1f}, corner {exact[0, 0]:.1f}")
assert np.allclose([exact[50, 100], exact[0, 0]], [50, 70.7], atol=0.1)
for size, corner in ((3, 50.4), (11, 52.1), (31, 52.0)):
    distances = distance_transform(mask, kernel_size=size)[0, 0].numpy()
    print(f"kornia, kernel_size={size}: side {distances[50, 100]:.1f}, corner {distances[0, 0]:.1f}")
    assert abs(distances[50, 100] - 50) < 0.6 and abs(distances[0, 0] - corner) < 0.2
PYTHON
echo "as described"
