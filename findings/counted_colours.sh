#!/usr/bin/env bash
# Distances of palettes whose weights are counts of pixels: POT 0.9.7.post1 sliced, and OpenCV's, of two picture sizes.
#
# Red, blue and white with shares of 0.6, 0.3 and 0.1; beside the same palette in a picture of a quarter of the pixels,
# and beside the shares in the other order. Distances in RGB, by shares and by counts (10000 pixels, 2500):
#                                              the same palette        the other order
#                                              shares    counts        shares    counts    counts, 10000 each
#   POT emd2, solve                            0         raises        0.64      raises    6384
#       sinkhorn2, reg 0.05                    0         0             0.64      6384      6384
#       sliced_wasserstein_distance            0         58            0.48      59        48
#       max_sliced_wasserstein_distance        0         95            0.81      99        81
#       wasserstein_1d, of red                 0         2325          0.05      2200      500
#   OpenCV 5.0.0.93 EMD                        0         0             0.64      0.064     0.64
#   SciPy 1.17.1 wasserstein_distance, of red  0         0             0.05      0.05      0.05
# and of OpenCV: 0 for a red picture and one that is red in 4 of 10 pixels, blue in the others, if the latter has as
# many red ones. It moves as much as the smaller picture has, as it documents, and forgets the rest. The sliced ones
# compare quantiles of sums that differ. All but sinkhorn2 give no warning. So scores of palettes grow
# with the size of pictures, and between a picture and its thumbnail they are large or nothing. Divide counts by their
# sum.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet POT==0.9.7.post1 opencv-python-headless==5.0.0.93 scipy==1.17.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import warnings

import cv2
import numpy as np
import ot
from scipy.stats import wasserstein_distance

COLOURS = np.array([[1.0, 0, 0], [0, 0, 1], [0.9, 0.9, 0.9]])
counts = np.array([6000.0, 3000, 1000])
costs = ot.dist(COLOURS, COLOURS, "euclidean")
red = np.ascontiguousarray(COLOURS[:, 0])


def signature(weights):
    return np.c_[weights, COLOURS].astype(np.float32)


METHODS = {
    "emd2": lambda one, other: ot.emd2(one, other, costs),
    "solve": lambda one, other: ot.solve(costs, one, other).value,
    "sinkhorn2": lambda one, other: ot.sinkhorn2(one, other, costs, 0.05),
    "sliced": lambda one, other: ot.sliced_wasserstein_distance(
        COLOURS, COLOURS, one, other, n_projections=500, seed=0),
    "max sliced": lambda one, other: ot.max_sliced_wasserstein_distance(COLOURS, COLOURS, one, other, seed=0),
    "1d": lambda one, other: ot.wasserstein_1d(red, red, one, other),
    "OpenCV": lambda one, other: cv2.EMD(signature(one), signature(other), cv2.DIST_L2)[0],
    "SciPy": lambda one, other: wasserstein_distance(red, red, one, other),
}
turned = counts[::-1].copy()
share = counts.sum()
CASES = {
    "same, shares": (counts / share, counts / share), "same, counts": (counts, counts / 4),
    "other, shares": (counts / share, turned / share), "other, counts": (counts, turned / 4),
    "other, equal counts": (counts, turned),
}
EXPECTED = {
    "emd2": (0, None, 0.64, None, 6384), "solve": (0, None, 0.64, None, 6384), "sinkhorn2": (0, 0, 0.64, 6384, 6384),
    "sliced": (0, 58, 0.48, 59, 48), "max sliced": (0, 95, 0.81, 99, 81), "1d": (0, 2325, 0.05, 2200, 500),
    "OpenCV": (0, 0, 0.64, 0.064, 0.64), "SciPy": (0, 0, 0.05, 0.05, 0.05),
}
for name, method in METHODS.items():
    row = []
    for (one, other), expected in zip(CASES.values(), EXPECTED[name], strict=True):
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                found = float(method(one, other))
            assert not caught or name == "sinkhorn2"
        except AssertionError:
            found = None
        row.append(found)
        assert (found is None) == (expected is None), (name, found)
        assert found is None or abs(found - expected) < 0.01 * expected + 0.001, (name, found, expected)
    print(f"{name}: {[value if value is None else round(value, 4) for value in row]}")
one = np.array([[6000, 1, 0, 0]], np.float32)
other = np.array([[6000, 1, 0, 0], [9000, 0, 0, 1]], np.float32)
print("OpenCV, red beside red and blue:", cv2.EMD(one, other, cv2.DIST_L2)[0])
assert cv2.EMD(one, other, cv2.DIST_L2)[0] == 0
PYTHON
echo "as described"
