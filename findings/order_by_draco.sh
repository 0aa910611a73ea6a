#!/usr/bin/env bash
# DracoPy 2.2.0: points and vertices come back in another order; one floater puts the others on a grid of 0.6.
#
# 1000 points in a cube of 1, with colours, as written by `encode(points, colors=...)` and read by `decode`. How many
# are still at their row, and the largest error of a coordinate:
#   compression_level=0                        1000     0.00003
#   1, the default, and 5                      1        0.00003
#   10                                         0        0.00003
#   preserve_order=True, levels 0, 1, 5, 10    1000     0.00003
#   a grid of 30 x 30 vertices with triangles  0 of 900; with preserve_order=True all
#   one point more, at (10000, 0, 0)           an error of 0.31 of the others: 14 bits for the whole box
# Colours follow their points. Labels, masks, features and harmonics kept in an array beside the file do not: each is
# another point's. No warning; the package's page has the option's name alone. Pass preserve_order=True.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet DracoPy==2.2.0 scipy==1.17.1 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import DracoPy
import numpy as np
from scipy.spatial import cKDTree

random = np.random.default_rng(0)
points = random.uniform(0, 1, (1000, 3))
colours = random.integers(0, 256, (1000, 3)).astype(np.uint8)


def tell(name, coded, original, expected):
    back = DracoPy.decode(coded)
    _, rows = cKDTree(original).query(back.points)
    same, error = int((rows == np.arange(len(rows))).sum()), np.abs(original[rows] - back.points).max()
    print(f"{name:30} {same:4} of {len(original)} at their row, largest error {error:.5f}")
    assert len(back.points) == len(original) and sorted(rows) == list(range(len(original))) and error < 0.0001
    assert expected[0] <= same <= expected[1]
    return back, rows


for options, expected in (
    ({}, (0, 10)),
    ({"compression_level": 0}, (1000, 1000)),
    ({"compression_level": 1}, (0, 10)),
    ({"compression_level": 5}, (0, 10)),
    ({"compression_level": 10}, (0, 10)),
    *(({"compression_level": level, "preserve_order": True}, (1000, 1000)) for level in (0, 1, 5, 10)),
):
    back, rows = tell(str(options)[-30:], DracoPy.encode(points, colors=colours, **options), points, expected)
    assert np.array_equal(np.asarray(back.colors), colours[rows]), "colours follow"

x, y = (part.ravel() for part in np.mgrid[:30, :30])
grid = np.stack([x, y, np.sin(x + 2 * y)], 1) / 30
corner = np.arange(900).reshape(30, 30)[:-1, :-1].ravel()
halves = [[corner, corner + 1, corner + 30], [corner + 1, corner + 31, corner + 30]]
faces = np.concatenate([np.stack(half, 1) for half in halves])
tell("triangles", DracoPy.encode(grid, faces.astype(np.uint32)), grid, (0, 30))
tell("triangles, preserve_order", DracoPy.encode(grid, faces.astype(np.uint32), preserve_order=True), grid, (900, 900))

far = DracoPy.decode(DracoPy.encode(np.vstack([points, [[10000, 0, 0]]]), preserve_order=True)).points
error = np.abs(far[:1000] - points).max()
print(f"with a floater: largest error {error:.3f}, step {10000 / (2**14 - 1):.3f}")
assert 0.25 < error < 0.32
PYTHON
echo "as described"
