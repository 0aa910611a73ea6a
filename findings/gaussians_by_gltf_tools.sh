#!/usr/bin/env bash
# A GLB of Gaussians opened and saved by packages for glTF: one keeps the extension's name and drops its numbers.
#
# 100 Gaussians as points with `KHR_gaussian_splatting`: POSITION, COLOR_0, and the four attributes of the extension,
# whose names have a colon, such as `KHR_gaussian_splatting:ROTATION`. What the saved file has:
#   gltflib 1.0.13     POSITION and COLOR_0; the extension stays in the primitive and in `extensionsUsed`, and what the
#                      attributes pointed to is still in the file, unnamed: it looks whole, and no program can show it
#   trimesh 5.2.0      POSITION and COLOR_0, as points
#   gltfpack 1.3.0     POSITION and COLOR_0, as points, with a warning for each attribute
#   pygltflib 1.16.5   everything, with the same numbers
# No word from the first two. Edit names, rights and nodes of such files by pygltflib; count `attributes` after saving.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 gltflib==1.0.13 pygltflib==1.16.5 trimesh==5.2.0
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 gltfpack@1.3.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import json
import struct
import subprocess

import gltflib
import numpy as np
import pygltflib
import trimesh

NAME = "KHR_gaussian_splatting"
random = np.random.default_rng(0)
rotations = random.normal(size=(100, 4))
arrays = {
    "POSITION": random.uniform(-1, 1, (100, 3)),
    "COLOR_0": random.uniform(0, 1, (100, 4)),
    f"{NAME}:ROTATION": rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
    f"{NAME}:SCALE": random.uniform(-5, -3, (100, 3)),
    f"{NAME}:OPACITY": random.uniform(0.2, 1, (100, 1)),
    f"{NAME}:SH_DEGREE_0_COEF_0": random.normal(size=(100, 3)),
}
arrays = {name: array.astype(np.float32) for name, array in arrays.items()}
binary, accessors, views = b"", [], []
for array in arrays.values():
    views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
    kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[array.shape[1]]
    bounds = {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
    accessors.append({"bufferView": len(accessors), "componentType": 5126, "count": 100, "type": kind, **bounds})
    binary += array.tobytes()
values = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}
attributes = {name: index for index, name in enumerate(arrays)}
document = {
    "asset": {"version": "2.0"},
    "extensionsUsed": [NAME],
    "scene": 0,
    "scenes": [{"nodes": [0]}],
    "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": attributes, "mode": 0, "extensions": {NAME: values}}]}],
    "accessors": accessors,
    "bufferViews": views,
    "buffers": [{"byteLength": len(binary)}],
}
text = json.dumps(document).encode()
text += b" " * (-len(text) % 4)
with open("scene.glb", "wb") as file:
    file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary)))
    file.write(struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)


def look(path):
    data = open(path, "rb").read()
    (length,) = struct.unpack("<I", data[12:16])
    saved = json.loads(data[20 : 20 + length])
    primitive = saved["meshes"][0]["primitives"][0]
    found = {}
    for name, index in primitive["attributes"].items():
        accessor = saved["accessors"][index]
        if accessor["componentType"] == 5126:
            view = saved["bufferViews"][accessor["bufferView"]]
            start = 28 + length + view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
            width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
            found[name] = np.frombuffer(data, "<f4", 100 * width, start).reshape(100, width)
    extension = NAME in primitive.get("extensions", {}), NAME in saved.get("extensionsUsed", [])
    print(f"{path}: {sorted(primitive['attributes'])}, extension {extension}, {len(saved['accessors'])} accessors")
    return set(primitive["attributes"]), extension, len(saved["accessors"]), found


assert look("scene.glb")[:3] == (set(arrays), (True, True), 6)
pygltflib.GLTF2().load("scene.glb").save("pygltflib.glb")
names, extension, _, found = look("pygltflib.glb")
assert names == set(arrays) and extension == (True, True)
assert all(np.array_equal(found[name], array) for name, array in arrays.items())

gltflib.GLTF.load("scene.glb").export("gltflib.glb")
assert look("gltflib.glb")[:3] == ({"POSITION", "COLOR_0"}, (True, True), 6)
trimesh.load("scene.glb").export("trimesh.glb")
assert look("trimesh.glb")[:2] == ({"POSITION", "COLOR_0"}, (False, False))
packed = subprocess.run(
    ["node_modules/.bin/node", "node_modules/gltfpack/cli.js", "-i", "scene.glb", "-o", "gltfpack.glb", "-noq", "-ke"],
    capture_output=True,
    text=True,
    check=True,
)
print((packed.stdout + packed.stderr).strip())
assert (packed.stdout + packed.stderr).count("ignoring unknown attribute") == 4
assert look("gltfpack.glb")[:2] == ({"POSITION", "COLOR_0"}, (False, False))
PYTHON
echo "as described"
