#!/usr/bin/env bash
# A GLB that glTF-Transform 4.2.1 made smaller, read by trimesh 5.2.0: 32767 times too large, and a mask is empty.
#
# A ball of radius 1, 5 units from the origin, with coordinates of a texture, and a mask that is 1 at each eighth vertex
# and else 0. After `quantize()`, a step of `gltf-transform optimize`, and after `sparse()`:
#                                      radius    middle    texture, largest    vertices in the mask
#   as trimesh exports it               1         5         1                   81
#   quantised                           32767     5         65535               81
#   quantised to 8 bits                 127       5         65535               81
#   sparse (core glTF 2.0)              1         5         1                   0
#   quantised and dequantised again     1         5         1                   81
# trimesh does not divide what a file calls normalised, nor add what a sparse accessor holds. No warning, though
# KHR_mesh_quantization is among the extensions that the file requires. Apply `dequantize()` before trimesh reads it.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 @gltf-transform/core@4.2.1 @gltf-transform/functions@4.2.1 \
    @gltf-transform/extensions@4.2.1
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 pillow==13.0.0 numpy==2.4.6
cat > smaller.mjs <<'SCRIPT'
import { NodeIO } from "@gltf-transform/core";
import { ALL_EXTENSIONS } from "@gltf-transform/extensions";
import { dequantize, quantize, sparse } from "@gltf-transform/functions";
import { writeFileSync } from "node:fs";

const io = new NodeIO().registerExtensions(ALL_EXTENSIONS);
const steps = {
  quantised: [quantize()],
  quantised8: [quantize({ quantizePosition: 8 })],
  sparse: [sparse({ ratio: 1 / 3 })],
  back: [quantize(), dequantize()],
};
for (const [name, transforms] of Object.entries(steps)) {
  const document = await io.read("ball.glb");
  await document.transform(...transforms);
  await io.write(`${name}.glb`, document);
}
SCRIPT
env/bin/python -W error::UserWarning - <<'PYTHON'
import json
import struct
import subprocess
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

ball = trimesh.creation.icosphere(3)
uv = ball.vertices[:, :2] / 2 + 0.5
mask = (np.arange(len(ball.vertices)) % 8 == 0).astype(np.float32)
ball.apply_translation([5, 0, 0])
ball.visual = trimesh.visual.TextureVisuals(uv, image=Image.new("RGB", (8, 8), "orange"))
ball.vertex_attributes["_mask"] = mask
ball.export("ball.glb")
subprocess.run(["node_modules/node/bin/node", "smaller.mjs"], check=True, capture_output=True)


def header(name):
    data = Path(f"{name}.glb").read_bytes()
    return json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])


for name, radius, largest, masked in (
    ("ball", 1, 1, 81),
    ("quantised", 32767, 65535, 81),
    ("quantised8", 127, 65535, 81),
    ("sparse", 1, 1, 0),
    ("back", 1, 1, 81),
):
    mesh = trimesh.load(f"{name}.glb").to_geometry()
    low, high = mesh.bounds
    (attribute,) = (key for key in mesh.vertex_attributes if "mask" in key.lower())
    masked_here = (mesh.vertex_attributes[attribute] > 0).sum()
    found = (high - low)[0] / 2, (high + low)[0] / 2, mesh.visual.uv.max(), masked_here
    print(f"{name:11} radius {found[0]:.3f}, middle {found[1]:.3f}, texture to {found[2]:.3f}, mask {found[3]}",
          header(name).get("extensionsRequired"))
    assert np.allclose(found[:3], (radius, 5, largest), rtol=0.01) and found[3] == masked
assert header("quantised")["extensionsRequired"] == ["KHR_mesh_quantization"]
PYTHON
echo "as described"
