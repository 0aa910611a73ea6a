#!/usr/bin/env bash
# trimesh 5.2.0: where two colours of a mesh meet, one is lost on loading; half of a blue triangle becomes red.
#
# Two triangles with a common side, red and blue, each with its own three vertices, as flat or posterised colours need
# them. Vertices, and colours of the second triangle, blue for each of its corners, as loaded:
#   PLY, OBJ, or Trimesh(vertices, faces, vertex_colors=...)   4: red, blue, red
#   the same with process=False                                6: blue, blue, blue
#   GLB                                                        6: blue, blue, blue
#   point-cloud-utils 0.34.0, of the PLY                       6: blue, blue, blue
# `process=True`, the default, merges vertices of one place whatever their colours are. Of a board of 10 x 10 squares
# in turn red and blue 198 of 200 triangles have a corner of the other colour afterwards. No warning.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 point-cloud-utils==0.34.0 plyfile==1.1.5 scipy==1.17.1 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import plyfile
import point_cloud_utils
import trimesh

RED, BLUE = [255, 0, 0], [0, 0, 255]


def written(vertices, faces, colours):
    rows = np.zeros(len(vertices), [(a, "f4") for a in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")])
    for names, values in ((("x", "y", "z"), vertices), (("red", "green", "blue"), colours)):
        for name, column in zip(names, np.asarray(values).T):
            rows[name] = column
    triangles = np.zeros(len(faces), [("vertex_indices", "i4", (3,))])
    triangles["vertex_indices"] = faces
    elements = [plyfile.PlyElement.describe(rows, "vertex"), plyfile.PlyElement.describe(triangles, "face")]
    plyfile.PlyData(elements).write("mesh.ply")
    raw = trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False)
    for name in ("mesh.obj", "mesh.glb"):
        raw.export(name)


def corners(mesh):
    """Colours of each triangle's corners."""
    return np.asarray(mesh.visual.vertex_colors)[:, :3][mesh.faces]


vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
faces, colours = np.arange(6).reshape(2, 3), np.array([RED] * 3 + [BLUE] * 3, np.uint8)
written(vertices, faces, colours)
for title, mesh, merged in (
    ("PLY", trimesh.load("mesh.ply"), True),
    ("OBJ", trimesh.load("mesh.obj"), True),
    ("Trimesh", trimesh.Trimesh(vertices, faces, vertex_colors=colours), True),
    ("PLY, process=False", trimesh.load("mesh.ply", process=False), False),
    ("OBJ, process=False", trimesh.load("mesh.obj", process=False), False),
    ("GLB", trimesh.load("mesh.glb").to_geometry(), False),
):
    second = corners(mesh)[1].tolist()
    print(f"{title:19} {len(mesh.vertices)} vertices, second triangle {second}")
    assert len(mesh.vertices) == (4 if merged else 6)
    assert sorted(second) == sorted([RED, BLUE, RED] if merged else [BLUE] * 3)
theirs = point_cloud_utils.load_triangle_mesh("mesh.ply")
found = np.round(theirs.vertex_data.colors[:, :3] * (255 if theirs.vertex_data.colors.max() <= 1 else 1))
print("point-cloud-utils", found[theirs.face_data.vertex_ids].tolist())
assert np.array_equal(found[theirs.face_data.vertex_ids], colours[faces])

square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
places = [(row, column) for row in range(10) for column in range(10)]
vertices = np.concatenate([square + [row, column, 0] for row, column in places])
faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(100)])
colours = np.repeat([BLUE if (row + column) % 2 else RED for row, column in places], 4, 0).astype(np.uint8)
board = trimesh.Trimesh(vertices, faces, vertex_colors=colours)
wrong = [len(np.unique(triangle, axis=0)) > 1 for triangle in corners(board)]
print(f"board: {len(board.vertices)} of {len(vertices)} vertices, {sum(wrong)} of {len(faces)} triangles wrong")
assert len(board.vertices) == 121 and len(wrong) == 200 and sum(wrong) > 150
PYTHON
echo "as described"
