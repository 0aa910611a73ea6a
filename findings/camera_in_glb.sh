#!/usr/bin/env bash
# trimesh 5.2.0: the camera of a GLB is another one after it was written, and after it was read; three 0.187 beside.
#
# glTF holds the vertical field of view and the ratio of width to height. trimesh takes the ratio of the two angles for
# the ratio of the sides, which it is not, and has one camera. A camera of 640 x 480 pixels, 60 degrees wide, f 554:
#   written by trimesh                          aspectRatio 1.281 for 1.333: three shows 58.0 degrees, 4 % too large
#   written by trimesh, read by trimesh         60 degrees, of 1800 x 1405 pixels: fx 1559, fy 1622
#   of a valid file of 60 degrees and 4:3       62.4 degrees, 1873 x 1405: fx 1545, fy 1622, where both are 1622
#   90 degrees and 16:9, as of a phone          104.4 degrees, 3131 x 1761: fx 1215, fy 1565
#   two cameras in a file                       the last one's lens and place, no word of the first
#   no aspectRatio, which glTF lets be absent   60 x 45 degrees from a place of its own, no word of the file's camera
# three reads all of them, with a ratio of 1 where there is none. No warning. Keep K beside the GLB, or take the
# vertical angle alone and the sides of the photograph.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 pygltflib==1.16.5 numpy==2.4.6
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0
cat > read.mjs <<'NODE'
import fs from "fs";
globalThis.self = globalThis;
const { GLTFLoader } = await import("three/examples/jsm/loaders/GLTFLoader.js");
const cameras = {};
for (const name of process.argv.slice(2)) {
  const file = fs.readFileSync(name);
  const bytes = file.buffer.slice(file.byteOffset, file.byteOffset + file.length);
  const scene = await new GLTFLoader().parseAsync(bytes, "");
  scene.scene.updateMatrixWorld(true);
  cameras[name] = scene.cameras.map((camera) => ({
    fov: camera.fov, aspect: camera.aspect, place: camera.matrixWorld.elements.slice(12, 15),
  }));
}
console.log(JSON.stringify(cameras));
NODE
env/bin/python -W error - <<'PYTHON'
import json
import subprocess

import numpy as np
import pygltflib
import trimesh
from trimesh.scene.cameras import Camera


def other_side(angle, ratio):
    return float(np.degrees(2 * np.arctan(np.tan(np.radians(angle) / 2) * ratio)))


scene = trimesh.Scene(trimesh.creation.box())
scene.camera = Camera(resolution=(640, 480), fov=(60, other_side(60, 480 / 640)))
scene.camera_transform = trimesh.transformations.translation_matrix([0, 0, 5])
assert np.allclose(scene.camera.K[[0, 1], [0, 1]], 554.256, atol=1e-3)
scene.export("written.glb")
plain = trimesh.Scene(trimesh.creation.box()).export(file_type="glb")


def file(name, *cameras):
    """A GLB with cameras of a vertical angle and a ratio of sides, the n-th at x = n + 1."""
    gltf = pygltflib.GLTF2.load_from_bytes(plain)
    gltf.cameras = []
    for angle, ratio in cameras:
        lens = pygltflib.Perspective(yfov=np.radians(angle), aspectRatio=ratio, znear=0.1)
        gltf.cameras.append(pygltflib.Camera(type="perspective", perspective=lens))
        count = len(gltf.cameras)
        gltf.nodes.append(pygltflib.Node(camera=count - 1, translation=[float(count), 2.0, 3.0]))
        gltf.scenes[0].nodes.append(len(gltf.nodes) - 1)
    gltf.save(name)


vertical, phone = other_side(60, 480 / 640), other_side(90, 9 / 16)
file("valid.glb", (vertical, 4 / 3))
file("phone.glb", (phone, 16 / 9))
file("two.glb", (vertical, 4 / 3), (phone, 16 / 9))
file("none.glb", (vertical, None))
names = ["written.glb", "valid.glb", "phone.glb", "two.glb", "none.glb"]
shown = subprocess.run(["node_modules/node/bin/node", "read.mjs", *names], capture_output=True, text=True, check=True)
assert not shown.stderr, shown.stderr
shown = json.loads(shown.stdout)
read = {}
for name in names:
    loaded = trimesh.load_scene(name)
    camera, place = loaded.camera, loaded.camera_transform[:3, 3]
    read[name] = camera.fov, camera.resolution, camera.K[[0, 1], [0, 1]], place
    wide = [round(other_side(found["fov"], found["aspect"]), 1) for found in shown[name]]
    print(f"{name:12} trimesh {camera.fov.round(1)} {camera.resolution} {read[name][2].round()} at {place.round(2)}")
    print(f"{'':12} three wide {wide} ratio {[round(found['aspect'], 3) for found in shown[name]]}")

(written,) = shown["written.glb"]
assert abs(written["aspect"] - 1.281) < 1e-3 and abs(other_side(written["fov"], written["aspect"]) - 58.0) < 0.05
assert abs(np.tan(np.radians(30)) / np.tan(np.radians(58.0 / 2)) - 1.04) < 0.005
expected = {
    "written.glb": ([60, vertical], [1800, 1405], [1559, 1622]),
    "valid.glb": ([vertical * 4 / 3, vertical], [1873, 1405], [1545, 1622]),
    "phone.glb": ([104.4, phone], [3131, 1761], [1215, 1565]),
}
for name, (angles, sides, focal) in expected.items():
    assert np.allclose(read[name][0], angles, atol=0.05)
    assert np.array_equal(read[name][1], sides) and np.allclose(read[name][2], focal, atol=1), name
assert np.array_equal(read["two.glb"][0], read["phone.glb"][0]) and np.allclose(read["two.glb"][3], [2, 2, 3])
assert np.allclose(read["none.glb"][0], [60, 45]) and not np.allclose(read["none.glb"][3], [1, 2, 3], atol=0.1)
assert [len(shown[name]) for name in names] == [1, 1, 1, 2, 1] and shown["none.glb"][0]["aspect"] == 1
assert np.allclose([found["place"] for found in shown["two.glb"]], [[1, 2, 3], [2, 2, 3]])
assert abs(other_side(shown["phone.glb"][0]["fov"], shown["phone.glb"][0]["aspect"]) - 90) < 1e-3
PYTHON
echo "as described"
