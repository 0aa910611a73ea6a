#!/usr/bin/env bash
# Blender 4.5.15, a camera to five formats and back, and into three 0.187.0: only USD keeps what it showed.
#
# 50 mm on a sensor of 36 x 24, 1920 x 1080; vertical field of view, the same with sensor fit "Vertical", and how far
# the optical axis lies from the middle with shift_x = 0.1 and shift_y = 0.05, in pixels:
#                               field     fit "Vertical"    axis off by        pose
#   in Blender                  22.9      27.0              (-192, 96)
#   USD, back into Blender      22.9      27.0              (-192, 96)         right
#   GLB, back into Blender      22.9      27.0              none               right
#   Alembic, FBX, DAE, back     22.9      22.9              (-192, 96)         right
#   GLB into three              22.9      27.0              none               right
#   FBX into three              22.3      22.3              none               100 times as far, looks 90 degrees aside
#   DAE into three              50.0      50.0              none               right
# An upright picture (1080 x 1920) with sensor fit "Horizontal" shows 65 degrees, and 40 after Alembic, FBX or DAE.
# three takes the 50 mm of an FBX for a film of 35 mm; of a DAE it reads `yfov`, and Blender writes `xfov`, so that 50
# is its default (reported publicly in 2015; that FBX is in centimetres is known). No warning, nor by the exporters.
# Export USD, or GLB without shift; set the sensor fit to "Auto" before; or write the projection matrix beside.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0 jsdom@31.0.1
python3 -m venv env
env/bin/pip install --quiet bpy==4.5.15 numpy==1.26.4
cat > cameras.py <<'PYTHON'
import json
import math

import bpy
import numpy as np

CAMERAS = {
    "plain": (1920, 1080, "AUTO", 0, 0),
    "vertical": (1920, 1080, "VERTICAL", 0, 0),
    "upright": (1080, 1920, "HORIZONTAL", 0, 0),
    "shifted": (1920, 1080, "AUTO", 0.1, 0.05),
}
EXPORT = {
    "usdc": bpy.ops.wm.usd_export, "glb": bpy.ops.export_scene.gltf, "abc": bpy.ops.wm.alembic_export,
    "fbx": bpy.ops.export_scene.fbx, "dae": bpy.ops.wm.collada_export,
}
IMPORT = {
    "usdc": bpy.ops.wm.usd_import, "glb": bpy.ops.import_scene.gltf, "abc": bpy.ops.wm.alembic_import,
    "fbx": bpy.ops.import_scene.fbx, "dae": bpy.ops.wm.collada_import,
}


def scene(width, height):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    render = bpy.context.scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    return bpy.context.scene


def made(width, height, fit, across, up):
    current = scene(width, height)
    lens = bpy.data.cameras.new("camera")
    lens.lens, lens.sensor_width, lens.sensor_height, lens.sensor_fit = 50, 36, 24, fit
    lens.shift_x, lens.shift_y = across, up
    camera = bpy.data.objects.new("camera", lens)
    current.collection.objects.link(camera)
    current.camera = camera
    camera.location, camera.rotation_euler = (1, 2, 3), (1.1, 0.2, 0.3)
    bpy.context.view_layer.update()
    return camera


def seen(camera, width, height):
    """Vertical field of view, the axis's place from the middle in pixels (right, down), and the pose."""
    matrix = np.array(camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=width, y=height))
    field = 2 * math.degrees(math.atan(1 / matrix[1, 1]))
    pose = np.array(camera.matrix_world)
    pose[:3, :3] /= np.linalg.norm(pose[:3, :3], axis=0)
    return field, -matrix[0, 2] * width / 2, matrix[1, 2] * height / 2, pose


truth = {}
for name, (width, height, *lens) in CAMERAS.items():
    right = seen(made(width, height, *lens), width, height)
    # In axes whose y is up, as GLB, FBX and DAE have them in three.
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    truth[name] = {"field": right[0], "place": (turn @ right[3][:3, 3]).tolist(),
                   "look": (-turn @ right[3][:3, 2]).tolist(), "up": (turn @ right[3][:3, 1]).tolist()}
    print(f"{name:9} in Blender  {right[0]:.2f}, axis {round(right[1])}, {round(right[2])}")
    assert abs(right[0] - {"plain": 22.895, "vertical": 26.991, "upright": 65.238, "shifted": 22.895}[name]) < 0.001
    assert np.allclose(right[1:3], (-192, 96) if name == "shifted" else (0, 0), atol=0.01)
    for suffix in EXPORT:
        made(width, height, *lens)
        EXPORT[suffix](filepath=f"{name}.{suffix}", **({"export_cameras": True} if suffix == "glb" else {}))
        scene(width, height)
        IMPORT[suffix](filepath=f"{name}.{suffix}")
        (camera,) = (item for item in bpy.context.scene.objects if item.type == "CAMERA")
        bpy.context.view_layer.update()
        found = seen(camera, width, height)
        print(f"{name:9} {suffix:4} back    {found[0]:.2f}, axis {round(found[1])}, {round(found[2])}")
        assert np.abs(found[3] - right[3]).max() < 1e-4
        lost = suffix in ("abc", "fbx", "dae") and name in ("vertical", "upright")
        assert abs(found[0] - ({"vertical": 22.895, "upright": 39.598}[name] if lost else right[0])) < 0.01
        assert np.allclose(found[1:3], (0, 0) if suffix == "glb" else right[1:3], atol=0.05)
with open("truth.json", "w") as file:
    json.dump(truth, file)
PYTHON
env/bin/python cameras.py > blender.log 2>&1 || { cat blender.log; exit 1; }
grep ", axis " blender.log
cat > cameras.mjs <<'PROGRAM'
import assert from "node:assert";
import { readFileSync } from "node:fs";
import { JSDOM } from "jsdom";

const { window } = new JSDOM("");
Object.assign(globalThis, { window, self: globalThis, document: window.document, DOMParser: window.DOMParser });
const words = [];
for (const kind of ["warn", "error"]) console[kind] = (...parts) => words.push(parts.join(" "));
const { Vector3 } = await import("three");
const { GLTFLoader } = await import("three/examples/jsm/loaders/GLTFLoader.js");
const { FBXLoader } = await import("three/examples/jsm/loaders/FBXLoader.js");
const { ColladaLoader } = await import("three/examples/jsm/loaders/ColladaLoader.js");

const bytes = (name) => new Uint8Array(readFileSync(name)).buffer;
const LOAD = {
  glb: (name) => new GLTFLoader().parseAsync(bytes(name), "").then((result) => result.scene),
  fbx: (name) => new FBXLoader().parse(bytes(name), ""),
  dae: (name) => new ColladaLoader().parse(readFileSync(name, "utf8"), "").scene,
};
const truth = JSON.parse(readFileSync("truth.json"));
for (const name of Object.keys(truth))
  for (const suffix of Object.keys(LOAD)) {
    const scene = await LOAD[suffix](`${name}.${suffix}`);
    scene.updateMatrixWorld(true);
    const cameras = [];
    scene.traverse((item) => item.isCamera && cameras.push(item));
    assert.strictEqual(cameras.length, 1);
    const [camera] = cameras;
    camera.updateProjectionMatrix();
    const right = truth[name];
    const angle = camera.getWorldDirection(new Vector3()).angleTo(new Vector3(...right.look)) * 180 / Math.PI;
    const place = new Vector3().setFromMatrixPosition(camera.matrixWorld);
    const far = place.length() / new Vector3(...right.place).length();
    const [, , , , , , , , across, up] = camera.projectionMatrix.elements;
    process.stdout.write(`${name.padEnd(9)} ${suffix} into three ${camera.fov.toFixed(2)}, axis ${across}, ${up}; `
      + `looks ${angle.toFixed(1)} degrees aside, ${far.toFixed(2)} times as far\n`);
    assert(Math.abs(across) < 1e-9 && Math.abs(up) < 1e-9);
    const fields = { glb: right.field, fbx: name === "upright" ? 38.58 : 22.275, dae: 50 };
    assert(Math.abs(camera.fov - fields[suffix]) < 0.01);
    assert(Math.abs(angle - (suffix === "fbx" ? 90 : 0)) < 0.1 && Math.abs(far - (suffix === "fbx" ? 100 : 1)) < 0.01);
  }
process.stdout.write(JSON.stringify(words) + "\n");
assert(words.every((line) => !/camera|fov/i.test(line)));
PROGRAM
node_modules/node/bin/node cameras.mjs
echo "as described"
