#!/usr/bin/env bash
# A GLB with a sparse accessor, or with a mirrored node, which glTF allows both: what four readers make of it.
#
# sparse   corners of a triangle, one of them moved from (1, 0, 0) to (5, 0, 0) by `accessor.sparse`: an area of 2.5
# mirror   a node of scale (-1, 1, 1): glTF says that its triangles are then taken the other way round; they look to +z
#                       sparse    mirror
#   three 0.187.0       2.5       +z (drawn by the determinant's sign)
#   Open3D 0.20.0       2.5       -z
#   trimesh 5.2.0       0.5       +z
#   pymeshlab 2025.7    0.5       -z
# No warning. `sparse` is what tools write for few changes, such as shapes of a face. trimesh has a mesh of the right
# number of vertices at other places; Open3D's mirrored half of a model is inside out beside the other half, which a
# renderer that leaves out backs does not show. Write files without the two: dense, transforms applied.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 open3d==0.20.0 pymeshlab==2025.7.post1 numpy==2.4.6
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0
cat > read.mjs <<'NODE'
import fs from "fs";
import { Triangle, Vector3 } from "three";
globalThis.self = globalThis;
const { GLTFLoader } = await import("three/examples/jsm/loaders/GLTFLoader.js");
const file = fs.readFileSync(process.argv[2]);
const bytes = file.buffer.slice(file.byteOffset, file.byteOffset + file.length);
const { scene } = await new GLTFLoader().parseAsync(bytes, "");
scene.updateMatrixWorld(true);
let area = 0, towards = 0;
scene.traverse((mesh) => {
  if (!mesh.isMesh) return;
  const { index, attributes: { position } } = mesh.geometry;
  const corner = (row) => new Vector3().fromBufferAttribute(position, index ? index.getX(row) : row)
    .applyMatrix4(mesh.matrixWorld);
  for (let row = 0; row < (index ?? position).count; row += 3) {
    const triangle = new Triangle(corner(row), corner(row + 1), corner(row + 2));
    area += triangle.getArea();
    towards += triangle.getNormal(new Vector3()).z * triangle.getArea() * Math.sign(mesh.matrixWorld.determinant());
  }
});
console.log(JSON.stringify([area, towards]));
NODE
env/bin/python -W error - <<'PYTHON'
import json
import struct
import subprocess
from pathlib import Path

import numpy as np
import open3d
import pymeshlab
import trimesh

open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Warning)
TRIANGLE = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], "<f4")


def write(name, arrays, accessors, primitives, **node):
    views, blob = [], b""
    for array in arrays:
        part = array.tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(part)})
        blob += part + bytes(-len(part) % 4)
    scene = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, **node}],
        "meshes": [{"primitives": primitives}], "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = [struct.pack("<I4s", len(part), kind) + part for part, kind in ((text, b"JSON"), (blob, b"BIN\0"))]
    body = b"".join(chunks)
    Path(name).write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def points(array, **more):
    low, high = array.min(0).tolist(), array.max(0).tolist()
    return {"componentType": 5126, "count": len(array), "type": "VEC3", "min": low, "max": high, **more}


sparse = {
    "count": 1,
    "indices": {"bufferView": 0, "byteOffset": 0, "componentType": 5123},
    "values": {"bufferView": 1, "byteOffset": 0},
}
moved = TRIANGLE * [5, 1, 1]
plain = [{"attributes": {"POSITION": 0}, "mode": 4}]
parts = [np.array([1], "<u2"), moved[[1]].astype("<f4"), TRIANGLE]
write("sparse.glb", parts, [points(moved, bufferView=2, sparse=sparse)], plain)
write("mirror.glb", [TRIANGLE], [points(TRIANGLE, bufferView=0)], plain, scale=[-1, 1, 1])


def of(corners, faces):
    a, b, c = (np.asarray(corners, float)[np.asarray(faces, int)[:, k]] for k in range(3))
    twice = np.cross(b - a, c - a)
    return np.linalg.norm(twice, axis=1).sum() / 2, twice.sum(0)[2] / 2


def by_trimesh(name):
    mesh = trimesh.load_mesh(name)
    return of(mesh.vertices, mesh.faces)


def by_open3d(name):
    mesh = open3d.io.read_triangle_mesh(name)
    return of(mesh.vertices, mesh.triangles)


def by_pymeshlab(name):
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(name)
    mesh = meshes.current_mesh()
    return of(mesh.transformed_vertex_matrix(), mesh.face_matrix())


def by_three(name):
    command = ["node_modules/.bin/node", "read.mjs", name]
    return json.loads(subprocess.run(command, capture_output=True, check=True).stdout)


for name, expected in (
    ("sparse", {by_three: (2.5, 2.5), by_open3d: (2.5, 2.5), by_trimesh: (0.5, 0.5), by_pymeshlab: (0.5, 0.5)}),
    ("mirror", {by_three: (0.5, 0.5), by_open3d: (0.5, -0.5), by_trimesh: (0.5, 0.5), by_pymeshlab: (0.5, -0.5)}),
):
    for way, wanted in expected.items():
        area, towards = way(f"{name}.glb")
        print(f"{name:7} {way.__name__:13} area {area:.2f}, towards +z {towards:.2f}")
        assert np.allclose((area, towards), wanted), (name, way)
PYTHON
echo "as described"
