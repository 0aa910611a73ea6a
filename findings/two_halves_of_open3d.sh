#!/usr/bin/env bash
# Open3D 0.20.0: points cleaned and thinned by its two halves, with the same numbers, differ; labels are averaged.
#
# 5000 points in a cube from -1 to 1 and one far away, by open3d.geometry and by open3d.t.geometry:
#                                                                  geometry             t.geometry
#   remove_radius_outlier(s), 1 point within 0.12                  4899 are left        5001: the far one stays
#       2, 3 points within 0.12                                    4554, 3905           4899, 4554
#   voxel_down_sample(0.2), without the far point                  1254                 987
#       of the same points, all moved by 0.07                      1254                 1234
#       labels 5, 5, 7, 7 of points of one voxel                   -                    6: a label that nothing has
#       colours of that voxel, red twice and green twice, bytes    -                    127, 127, 0
#       two normals of length 1, at a right angle                  length 0.71          length 0.71
# A point counts as a neighbour of itself in t.geometry: ask for one more there. Cells begin half a voxel before the
# lowest coordinate in geometry, so that a floater shifts them, and at 0 in t.geometry. Pages speak of neighbours in
# both, and of a mean. No warning. Set labels again by the nearest of the old points, and normalise normals.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet open3d==0.20.0 scipy==1.17.1 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import open3d
from scipy.spatial import cKDTree

points = np.random.default_rng(0).uniform(-1, 1, (5000, 3))
with_floater = np.vstack([points, [[10.0, 10, 10]]])


def old(rows):
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(rows))


def new(rows):
    return open3d.t.geometry.PointCloud(open3d.core.Tensor(np.ascontiguousarray(rows)))


others = np.array([len(near) - 1 for near in cKDTree(with_floater).query_ball_point(with_floater, 0.12)])
for number in (1, 2, 3):
    left = len(old(with_floater).remove_radius_outlier(number, 0.12)[1])
    mask = new(with_floater).remove_radius_outliers(number, 0.12)[1].numpy().ravel()
    print(f"{number} within 0.12: {left} and {mask.sum()} left; the far one stays in t.geometry: {bool(mask[-1])}")
    assert left == (others >= number).sum() and mask.sum() == (others + 1 >= number).sum()
    assert mask[-1] == (number == 1)


def cells(rows, origin):
    return len(np.unique(np.floor((rows - origin) / 0.2), axis=0))


for moved in (0, 0.07):
    rows = points + moved
    found = len(old(rows).voxel_down_sample(0.2).points), len(new(rows).voxel_down_sample(0.2).point.positions)
    print(f"voxels of 0.2, moved by {moved}: {found}")
    assert found == (cells(rows, rows.min(0) - 0.1), cells(rows, 0))
    assert found == ((1254, 987) if moved == 0 else (1254, 1234))

four = new(np.linspace(0.01, 0.04, 4)[:, None].repeat(3, 1).astype(np.float32))
four.point.labels = open3d.core.Tensor(np.array([[5], [5], [7], [7]], np.int32))
four.point.colors = open3d.core.Tensor(np.array([[255, 0, 0], [255, 0, 0], [0, 255, 0], [0, 255, 0]], np.uint8))
one = four.voxel_down_sample(1.0).point
print("labels", one.labels.numpy().tolist(), "colours", one.colors.numpy().tolist())
assert one.labels.numpy().tolist() == [[6]] and one.colors.numpy().tolist() == [[127, 127, 0]]

two = new(np.array([[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]]))
two.point.normals = open3d.core.Tensor(np.array([[1.0, 0, 0], [0, 1, 0]]))
lengths = [
    np.linalg.norm(np.asarray(two.to_legacy().voxel_down_sample(1.0).normals)),
    np.linalg.norm(two.voxel_down_sample(1.0).point.normals.numpy()),
]
print("lengths of the mean normal", lengths)
assert np.allclose(lengths, 0.5**0.5)
PYTHON
echo "as described"
