#!/usr/bin/env bash
# A camera straight above a scene, looking down: what `lookAt` is where "up" lies along the view, by eight packages.
#
# From (0, 5, 0) to the origin, up (0, 1, 0), as of a plan or of the top of an orbit. How it is turned is open; any turn
# will do. Seen, the rank of the rotation, 3 where there is one:
#   three 0.187.0 Object3D.lookAt, @babylonjs/core 9.28.0 LookAtLH and LookAtRH      3, the camera looks down
#   gl-matrix 3.4.4 mat4.lookAt                          1: two rows of zeros, all points fall on the middle
#   playcanvas 2.23.3 Mat4.setLookAt                     1; GraphNode.lookAt then keeps no turn: it looks to -z
#   PyGLM 2.8.3 lookAt                                   NaN; quatLookAt is no rotation: of norm 0.71
#   pyrr 0.10.3 matrix44.create_look_at                  NaN
#   Open3D 0.20.0 RaycastingScene.create_rays_pinhole    NaN: nothing is hit, depth is infinite
#   pyvista 0.49.1, Camera, its matrix                   1
# No warning by any (NumPy's own for a division within pyrr). A ten-thousandth of a unit beside the axis all have
# rank 3. Give another up, such as (0, 0, 1), where a camera looks along the first.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0 @babylonjs/core@9.28.0 gl-matrix@3.4.4 \
    playcanvas@2.23.3
python3 -m venv env
env/bin/pip install --quiet PyGLM==2.8.3 pyrr==0.10.3 open3d==0.20.0 pyvista==0.49.1 numpy==2.4.6
cat > look.mjs <<'SCRIPT'
import { Matrix, Vector3 as Vector } from "@babylonjs/core/Maths/math.vector.js";
import { mat4 } from "gl-matrix";
import { GraphNode, Mat4, Vec3 } from "playcanvas";
import { PerspectiveCamera } from "three";

const found = {};
for (const x of [0, 1e-4]) {
  const eye = [x, 5, 0];
  const middle = [0, 0, 0];
  const up = [0, 1, 0];
  const three = new PerspectiveCamera();
  three.position.set(...eye);
  three.lookAt(...middle);
  three.updateMatrixWorld();
  const node = new GraphNode();
  node.setPosition(...eye);
  node.lookAt(...middle);
  const vectors = [eye, middle, up].map((v) => new Vector(...v));
  const all = {
    three: three.matrixWorld.elements,
    "babylon LookAtLH": Matrix.LookAtLH(...vectors).m,
    "babylon LookAtRH": Matrix.LookAtRH(...vectors).m,
    "gl-matrix": mat4.lookAt(mat4.create(), eye, middle, up),
    "playcanvas Mat4": new Mat4().setLookAt(...[eye, middle, up].map((v) => new Vec3(...v))).data,
    "playcanvas GraphNode": node.getWorldTransform().data,
  };
  for (const [name, matrix] of Object.entries(all)) (found[name] ??= []).push(Array.from(matrix));
}
console.log(JSON.stringify(found));
SCRIPT
node_modules/node/bin/node look.mjs > found.json
env/bin/python -W error::UserWarning - <<'PYTHON'
import json
import warnings

import glm
import numpy as np
import open3d as o3d
import pyrr
import pyvista

with open("found.json") as file:
    found = {name: [np.reshape(m, (4, 4)) for m in two] for name, two in json.load(file).items()}
ray = o3d.t.geometry.RaycastingScene.create_rays_pinhole
for x in (0, 1e-4):
    eye, middle, up = np.array([x, 5.0, 0]), np.zeros(3), np.array([0, 1.0, 0])
    found.setdefault("PyGLM", []).append(np.array(glm.lookAt(*(glm.vec3(*v) for v in (eye, middle, up)))))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found.setdefault("pyrr", []).append(pyrr.matrix44.create_look_at(eye, middle, up))
    camera = pyvista.Camera()
    camera.position, camera.focal_point, camera.up = eye, middle, up
    matrix = pyvista.array_from_vtkmatrix(camera.GetModelViewTransformMatrix())
    found.setdefault("pyvista", []).append(matrix)
    found.setdefault("open3d", []).append(ray(60.0, middle, eye, up, 4, 4).numpy()[..., 3:].reshape(-1, 3)[[0, 3, 12]])


def rank(matrix):
    part = np.asarray(matrix, float)[:3, :3]
    return "NaN" if np.isnan(part).any() else int(np.linalg.matrix_rank(part, tol=1e-3))


expected = dict.fromkeys(("three", "babylon LookAtLH", "babylon LookAtRH", "playcanvas GraphNode"), 3)
expected |= dict.fromkeys(("gl-matrix", "playcanvas Mat4", "pyvista"), 1)
expected |= dict.fromkeys(("PyGLM", "pyrr", "open3d"), "NaN")
for name, (above, beside) in found.items():
    print(f"{name:21} above: {rank(above)}, a ten-thousandth beside: {rank(beside)}")
    assert rank(above) == expected[name] and rank(beside) == 3, name
assert np.allclose(-found["three"][0][2, :3], [0, -1, 0], atol=1e-3)
assert np.allclose(found["playcanvas GraphNode"][0][:3, :3], np.eye(3)), "it looks to -z"
assert np.allclose(-found["playcanvas GraphNode"][1][2, :3], [0, -1, 0], atol=1e-3)
turn = glm.quatLookAt(glm.vec3(0, -1, 0), glm.vec3(0, 1, 0))
print("PyGLM quatLookAt", turn)
assert abs(glm.length(turn) - 0.707) < 0.001
scene = o3d.t.geometry.RaycastingScene()
scene.add_triangles(o3d.t.geometry.TriangleMesh.create_box(2.0, 0.1, 2.0).translate([-1.0, 0.0, -1.0]))
hits = [scene.cast_rays(ray(20.0, np.zeros(3), np.array([x, 5.0, 0]), np.array([0, 1.0, 0]), 8, 8))["t_hit"].numpy()
        for x in (0, 1e-4)]
print("Open3D, rays that hit a plate below:", [int(np.isfinite(hit).sum()) for hit in hits])
assert [int(np.isfinite(hit).sum()) for hit in hits] == [0, 64]
PYTHON
echo "as described"
