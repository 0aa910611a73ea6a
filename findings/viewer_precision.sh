#!/usr/bin/env bash
# What three viewers keep of Gaussians whose numbers were exact: directions of needles, and sizes of small ones.
#
# 1. Babylon.js 9.28.0 (core) and gsplat 1.2.9 (gsplat.js, of npm) round the rotations of a PLY to four bytes, though it
#    holds floats. A Gaussian is turned by 0.43 degrees in the mean and by up to 0.81; in Babylon one that is not rotated
#    at all by 0.78, for no byte stands for 0 (128 of 0 to 255 is 1/255). Both ends of a needle 150 times as long as it is
#    wide lie a width beside their places. Positions and sizes stay floats. gsplat.js leaves quaternions unnormalised, of norm 0.99.
# 2. viser 1.1.1 sends covariances, squares of sizes, in half precision: sizes of 0.001 are off by up to 0.7 %, of
#    0.0003 by 15 %, below 0.00017 they are 0, above 255 infinite. A disc of 0.1, a hundredth as thick, tilted, has a
#    negative variance. Its `scale=` acts on what is left; scale the scene instead, so that small ones are 0.01 or more.
# Only the overflow warns (NumPy's own words).
# Seen: 1000 random Gaussians, by the packages' own functions, without a screen. Node.js 22 of npm.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 @babylonjs/core@9.28.0 gsplat@1.2.9
python3 -m venv env
env/bin/pip install --quiet viser==1.1.1 plyfile==1.1.2 numpy==2.4.6
cat > read.mjs <<'JAVASCRIPT'
import { readFileSync, writeFileSync } from "fs";
import { GaussianSplattingMesh } from "@babylonjs/core/Meshes/GaussianSplatting/gaussianSplattingMesh.js";
import { PLYLoader, Scene } from "gsplat";

const file = readFileSync("scene.ply");
const data = file.buffer.slice(file.byteOffset, file.byteOffset + file.byteLength);
const rows = await GaussianSplattingMesh.ConvertPLYToSplatAsync(data.slice(0));
writeFileSync("babylon.bin", Buffer.from(rows));
writeFileSync("gsplat.bin", Buffer.from(new Float32Array(PLYLoader.LoadFromArrayBuffer(data, new Scene()).data.rotations).buffer));
JAVASCRIPT
env/bin/python - <<'PYTHON'
import subprocess
import warnings

import numpy as np
import viser
from plyfile import PlyData, PlyElement

generator = np.random.default_rng(0)
names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
rows = np.zeros(1000, [(name, "f4") for name in [*names, "rot_0", "rot_1", "rot_2", "rot_3"]])
for name in names:
    rows[name] = generator.normal(size=1000)
turns = generator.normal(size=(1000, 4))
turns[0] = 1, 0, 0, 0
turns /= np.linalg.norm(turns, axis=1, keepdims=True)
for number in range(4):
    rows[f"rot_{number}"] = turns[:, number]
PlyData([PlyElement.describe(rows, "vertex")]).write("scene.ply")
subprocess.run(["node_modules/node/bin/node", "read.mjs"], check=True)

splats = np.fromfile("babylon.bin", np.uint8).reshape(1000, 32)
shapes = splats[:, :24].copy().view("<f4")
assert np.array_equal(shapes[:, :3], np.stack([rows[name] for name in "xyz"], 1))
assert np.allclose(np.log(shapes[:, 3:]), np.stack([rows[f"scale_{i}"] for i in range(3)], 1), atol=1e-5)
read = {"Babylon.js": splats[:, 28:] / 127.5 - 1, "gsplat.js": np.fromfile("gsplat.bin", "<f4").reshape(1000, 4)}
for name, quaternions in read.items():
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    angle = np.degrees(2 * np.arccos(np.minimum(np.abs((quaternions / norms * turns).sum(1)), 1)))
    print(f"{name}: turned by {angle.mean():.2f} on average, {angle.max():.2f} at most, not rotated {angle[0]:.2f}")
    assert 0.4 < angle.mean() < 0.5 and 0.75 < angle.max() < 0.85
    assert abs(angle[0] - (0.78 if name == "Babylon.js" else 0)) < 0.01
    assert abs(norms[0, 0] - (1 if name == "Babylon.js" else 0.992)) < 0.001

server = viser.ViserServer(port=0, verbose=False)


def kept(covariance):
    """The covariance that is sent."""
    ones = np.ones((1, 3))
    splat = server.scene.add_gaussian_splats(
        "/splat", centers=0 * ones, covariances=np.asarray(covariance)[None], rgbs=ones, opacities=ones[:, :1]
    )
    upper = splat.buffer.view(np.uint8)[0, 16:28].copy().view(np.float16).astype(float)
    return upper[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)


with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    sizes = {size: float(np.sqrt(kept(size**2 * np.eye(3))[0, 0]) / size) for size in (0.01, 0.001, 0.0003, 0.00016)}
    lean = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    disc = np.linalg.eigvalsh(kept(lean @ np.diag([0.1, 0.001, 0.1]) ** 2 @ lean.T))
    assert not caught
    large = kept(256.0**2 * np.eye(3))[0, 0]
    assert [warning.category for warning in caught] == [RuntimeWarning]
server.stop()
print(f"viser: what is left of sizes: {sizes}; variances of a disc: {disc}; of a size of 256: {large}")
assert abs(sizes[0.01] - 1) < 0.001 and 0.005 < abs(sizes[0.001] - 1) < 0.01
assert 0.14 < abs(sizes[0.0003] - 1) < 0.16 and sizes[0.00016] == 0
assert disc[0] < 0 and large == np.inf
PYTHON
echo "as described"
