#!/usr/bin/env bash
# Points whose PLY has colours of another type than bytes: seven readers, and who makes black or white of them.
#
# PLY names a type for each property. Orange (255, 128, 0) and a blue (10, 20, 250), as read:
#                               uchar   float, 0 to 1            float, 0 to 255        ushort, 0 to 65535
#   open3d.io of Open3D 0.20.0  right   black: 1 becomes 1/255   right                  257 times too bright
#   open3d.t.io                 right   right                    as they are, 0 to 255  left out, with a warning
#   trimesh 5.2.0               right   right                    255, 255, 0; white     right
#   pyvista 0.49.1              right   black: 1, 0, 0; 0, 0, 0  right                  right
#   pymeshlab 2025.7.post1      right   white                    white                  white
#   point-cloud-utils 0.34.0    right   right                    as they are            as they are
#   meshio 5.3.5                         -1, -128, 0 and 10, 20, -6: bytes are signed; floats right; ushort a KeyError
# No warning but the one. Write uchar for others to read, and look at the largest value of what comes.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet open3d==0.20.0 trimesh==5.2.0 pyvista==0.49.1 pymeshlab==2025.7.post1 \
    point-cloud-utils==0.34.0 meshio==5.3.5 plyfile==1.1.5 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import meshio
import numpy as np
import open3d
import plyfile
import point_cloud_utils
import pymeshlab
import pyvista
import trimesh

CHANNELS = ("red", "green", "blue")
colours = np.array([[255, 128, 0], [10, 20, 250]], float)


def write(kind, factor):
    rows = np.zeros(2, [(axis, "f4") for axis in "xyz"] + [(name, kind) for name in CHANNELS])
    rows["x"] = 0, 1
    for name, values in zip(CHANNELS, colours.T):
        rows[name] = values * factor
    plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")]).write("points.ply")


def by_pymeshlab():
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh("points.ply")
    return meshes.current_mesh().vertex_color_matrix()[:, :3]


def by_meshio():
    data = meshio.read("points.ply").point_data
    return np.stack([data[name] for name in CHANNELS], 1).astype(float)


def by_pyvista():
    mesh = pyvista.read("points.ply")
    return mesh.point_data[mesh.array_names[0]]


readers = {
    "open3d.io": lambda: np.asarray(open3d.io.read_point_cloud("points.ply").colors),
    "open3d.t.io": lambda: open3d.t.io.read_point_cloud("points.ply").point.colors.numpy(),
    "trimesh": lambda: np.asarray(trimesh.load("points.ply").colors)[:, :3],
    "pyvista": by_pyvista,
    "pymeshlab": by_pymeshlab,
    "point-cloud-utils": lambda: point_cloud_utils.load_triangle_mesh("points.ply").vertex_data.colors[:, :3],
    "meshio": by_meshio,
}
unit, white, cut = colours / 255, np.ones((2, 3)), [[1, 0, 0], [0, 0, 0]]
expected = {
    ("u1", 1): [unit, colours, colours, colours, unit, colours, [[-1, -128, 0], [10, 20, -6]]],
    ("f4", 1 / 255): [unit / 255, unit, colours, cut, white, unit, unit],
    ("f4", 1): [unit, colours, [[255, 255, 0], [255] * 3], colours, white, colours, colours],
    ("u2", 257): [unit * 257, KeyError, colours, colours, white, colours * 257, KeyError],
    ("u2", 1): [unit, KeyError, colours, colours, white, colours, KeyError],
}
for (kind, factor), row in expected.items():
    write(kind, factor)
    for (name, read), answer in zip(readers.items(), row):
        try:
            found = np.asarray(read(), float)
        except KeyError as error:
            found = error
        shown = found if answer is KeyError else np.round(found, 4).tolist()
        print(f"{kind} times {factor:.4g}, {name:18} {shown}")
        assert isinstance(found, KeyError) if answer is KeyError else np.allclose(found, answer, atol=1e-5)
PYTHON
echo "as described"
