#!/usr/bin/env bash
# Faces with a corner that points inwards, as of walls and letters: five readers, and whose surface is too large.
#
# One flat face of an L (six corners, area 3), and of an arrowhead (four corners, area 1), in OBJ, PLY and OFF. The area
# of what is read, where a corner other than the inward one or its opposite comes first:
#                                                         L                     arrowhead
#   Open3D 0.20.0, read_triangle_model, t.io              3                     1
#           io.read_triangle_mesh, PLY, OFF; OBJ          3; nothing is left    1; nothing is left, and a line says so
#   point-cloud-utils 0.34.0, OBJ                         3                     1
#   pymeshlab 2025.7, OBJ and OFF; PLY                    3; 4                  3; 3
#   trimesh 5.2.0                                         4                     3
#   three 0.187.0, OBJ; PLY                               4; nothing is left    3; 3
# Where the inward corner comes first, all that is read is right: triangles are laid about the first corner, or a face
# of four is always cut by the same diagonal. Otherwise they cover what is outside of the face, and some are turned
# over: points that are spread over the surface lie beside it, rays hit what is not there, and normals are of both
# signs. No other warning. Make triangles where the mesh was made, or read it by Open3D's t.io.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 open3d==0.20.0 pymeshlab==2025.7.post1 \
    point-cloud-utils==0.34.0 numpy==2.4.6
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0
cat > area.mjs <<'NODE'
import { readFileSync } from "node:fs"
import { Triangle, Vector3 } from "three"
import { OBJLoader } from "three/examples/jsm/loaders/OBJLoader.js"
import { PLYLoader } from "three/examples/jsm/loaders/PLYLoader.js"

for (const name of process.argv.slice(2)) {
    const text = readFileSync(name, "utf8")
    const obj = name.endsWith("obj")
    const read = obj ? new OBJLoader().parse(text).children[0].geometry : new PLYLoader().parse(text)
    const geometry = read.index ? read.toNonIndexed() : read
    const corner = (row) => new Vector3().fromBufferAttribute(geometry.attributes.position, row)
    let area = 0
    for (let row = 0; (obj || read.index) && row < geometry.attributes.position.count; row += 3) {
        area += new Triangle(corner(row), corner(row + 1), corner(row + 2)).getArea()
    }
    console.log(area)
}
NODE
env/bin/python -W error::UserWarning - <<'PYTHON'
import subprocess
from pathlib import Path

import numpy as np
import open3d
import point_cloud_utils
import pymeshlab
import trimesh


def area(corners, faces):
    a, b, c = (np.asarray(corners, float)[np.asarray(faces, int)[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def of_open3d(mesh):
    return area(mesh.vertices, np.asarray(mesh.triangles).reshape(-1, 3)) if len(mesh.triangles) else 0.0


def by_three(name):
    command = ["node_modules/.bin/node", "area.mjs", name]
    return float(subprocess.run(command, capture_output=True, check=True).stdout)


def by_pymeshlab(name):
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(name)
    mesh = meshes.current_mesh()
    return area(mesh.vertex_matrix(), mesh.face_matrix())


ways = {
    "trimesh": lambda name: trimesh.load_mesh(name).area,
    "three": by_three,
    "pymeshlab": by_pymeshlab,
    "point-cloud-utils": lambda name: area(*point_cloud_utils.load_mesh_vf(name)),
    "Open3D": lambda name: of_open3d(open3d.io.read_triangle_mesh(name)),
    "Open3D t.io": lambda name: of_open3d(open3d.t.io.read_triangle_mesh(name).to_legacy()),
    "Open3D model": lambda name: sum(of_open3d(part.mesh) for part in open3d.io.read_triangle_model(name).meshes),
}
kinds = {
    "trimesh": ("obj", "ply", "off"), "three": ("obj", "ply"), "pymeshlab": ("obj", "ply", "off"),
    "point-cloud-utils": ("obj",),
    "Open3D": ("obj", "ply", "off"), "Open3D t.io": ("obj", "ply", "off"), "Open3D model": ("obj",),
}
expected = {  # of an L and of an arrowhead; one number for all formats, or one for each
    "trimesh": (4, 3), "three": ((4, 0), 3), "pymeshlab": ((3, 4, 3), 3),
    "point-cloud-utils": (3, 1), "Open3D": ((0, 3, 3), (0, 1, 1)), "Open3D t.io": (3, 1), "Open3D model": (3, 1),
}
shapes = {
    "L": (3, [(1, 1), (1, 2), (0, 2), (0, 0), (2, 0), (2, 1)]),
    "arrowhead": (1, [(1, 1), (0, 0), (2, 1), (0, 2)]),
}


def write(kind, points):
    lines, row = [f"{x} {y} 0" for x, y in points], " ".join(map(str, range(len(points))))
    if kind == "obj":
        lines = [*(f"v {line}" for line in lines), "f " + " ".join(str(k + 1) for k in range(len(points)))]
    elif kind == "off":
        lines = ["OFF", f"{len(points)} 1 0", *lines, f"{len(points)} {row}"]
    else:
        axes = [f"property float {axis}" for axis in "xyz"]
        head = ["ply", "format ascii 1.0", f"element vertex {len(points)}", *axes, "element face 1"]
        lines = [*head, "property list uchar int vertex_indices", "end_header", *lines, f"{len(points)} {row}"]
    Path(f"face.{kind}").write_text("\n".join([*lines, ""]))
    return f"face.{kind}"


for column, (shape, (true, points)) in enumerate(shapes.items()):
    for first in (0, 1):  # the inward corner, or the next one
        order = points[first:] + points[:first]
        for name, way in ways.items():
            found = [float(way(write(kind, order))) for kind in kinds[name]]
            print(f"{shape:9} {('inward corner', 'next corner')[first]:13} {name:18}", *zip(kinds[name], found))
            if first:
                assert np.allclose(found, expected[name][column]), name
            else:
                left_out = {("Open3D", "obj"): 0, ("three", "ply"): true % 3}
                assert np.allclose(found, [left_out.get((name, kind), true) for kind in kinds[name]]), name
PYTHON
echo "as described"
