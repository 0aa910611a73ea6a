#!/usr/bin/env bash
# point-cloud-utils 0.34.0: its earth mover's distance of two clouds is below the least that is possible, by a fifth.
#
# Two clouds of 100 points, in a cube of some side, compared by `earth_movers_distance(a, b)` and by the exact plans of
# POT 0.9.7.post1 (`emd2`) and SciPy 1.17.1 (`linear_sum_assignment`), which agree:
#   side of the cube                                            0.1       1        10       100
#   earth_movers_distance / exact                               0.89      0.81     0.81     0.81
#   what leaves a point, where each has to give 1               0.5 to 2  0.3 to 4  1/4 to 4 1/4 to 4
#   earth_movers_distance(b, a) / exact                         0.90      0.83     0.83     0.83
#   with max_iters=2000                                                   0.94
#   with max_iters=1000, eps a tenth of the exact distance                1.04
# 100 iterations are too few for an `eps` of 1e-4, which is in units of the scene, and the plan that comes back moves a
# third of some points and others four times: near ones are used more than once. The columns are right, the rows are
# not; exchange a and b, and another number comes. No warning. Look at P.sum(1), or take ot.emd2, which is exact.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet point-cloud-utils==0.34.0 POT==0.9.7.post1 scipy==1.17.1 numpy==2.4.6
OMP_NUM_THREADS=1 env/bin/python -W error - <<'PYTHON'
import numpy as np
import ot
import point_cloud_utils as pcu
from scipy.optimize import linear_sum_assignment

NUMBER = 100
random = np.random.default_rng(0)
first = random.random((NUMBER, 3))
second = random.random((NUMBER, 3)) + [0.1, 0, 0]


def compare(side, **options):
    a, b = first * side, second * side
    costs = np.linalg.norm(a[:, None] - b[None], axis=-1)
    exact = costs[linear_sum_assignment(costs)].mean()
    weights = np.full(NUMBER, 1 / NUMBER)
    assert np.isclose(ot.emd2(weights, weights, costs), exact, rtol=1e-9)
    distance, plan = pcu.earth_movers_distance(a, b, **options)
    swapped, _ = pcu.earth_movers_distance(b, a, **options)
    assert np.isclose((plan * costs).sum(), distance)
    rows, columns = plan.sum(1) * NUMBER, plan.sum(0) * NUMBER
    print(f"side {side}, {options}: exact {exact:.5f}, found {distance:.5f}, {distance / exact:.3f} of it, swapped "
          f"{swapped / exact:.3f}, rows {rows.min():.2f} to {rows.max():.2f}, "
          f"columns {columns.min():.3f} to {columns.max():.3f}")
    assert np.allclose(columns, 1, atol=1e-3)
    return distance / exact, swapped / exact, rows, exact


for side, expected, other in ((0.1, 0.895, 0.899), (1, 0.811, 0.832), (10, 0.814, 0.833), (100, 0.814, 0.833)):
    share, swapped, rows, exact = compare(side)
    assert abs(share - expected) < 0.02 and abs(swapped - other) < 0.02 and abs(swapped - share) > 1e-3
    assert rows.min() < 0.6 and rows.max() > 1.9
share, _, rows, exact = compare(1, max_iters=2000)
assert 0.9 < share < 0.97 and rows.max() > 1.1
share, _, rows, _ = compare(1, eps=exact / 10, max_iters=1000)
assert 1.02 < share < 1.06 and np.allclose(rows, 1, atol=0.02)
PYTHON
echo "as described"
