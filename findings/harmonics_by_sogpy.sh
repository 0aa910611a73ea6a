#!/usr/bin/env bash
# sogpy 1.0.2, PLY to SOG: what depends on the direction in red is shown in green and blue.
#
# `f_rest` of a PLY of degree 3 has fifteen coefficients of red, then green's, then blue's. sogpy takes them for red,
# green, blue of the first, of the second, and so on, so that f_rest_1, of red, comes to stand where f_rest_15 is,
# green's first. Seen: 2000 Gaussians whose red alone depends on the direction, read by splat-transform 3.7.0 and by
# gaussforge 0.6.0: a third of that is green and a third is blue, all in the first five coefficients of fifteen. All is
# red in splat-transform's own SOG. Positions and plain colours are right. No warning. Use splat-transform.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 @playcanvas/splat-transform@3.7.0
python3 -m venv env
env/bin/pip install --quiet sogpy==1.0.2 gaussforge==0.6.0 plyfile==1.1.5 scipy==1.17.1 pillow==12.3.0 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import subprocess
from pathlib import Path

import gaussforge
import numpy as np
from plyfile import PlyData, PlyElement
from scipy.spatial import cKDTree

TRANSFORM = ["node_modules/node/bin/node", "node_modules/.bin/splat-transform", "-w"]
random, count = np.random.default_rng(0), 2000
names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45)), "opacity"]
names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
rows = np.zeros(count, [(name, "f4") for name in names])
for name in names:
    if not name.startswith("f_rest"):
        rows[name] = random.normal(-4 if name.startswith("scale") else 0, 0.5, count)
kinds = random.normal(0, 0.2, (40, 15))[random.integers(0, 40, count)]
for index in range(15):
    rows[f"f_rest_{index}"] = kinds[:, index]
PlyData([PlyElement.describe(rows, "vertex")]).write("scene.ply")


def columns(rows, start, count):
    return np.stack([rows[f"{start}{index}"] for index in range(count)], 1)


def by_transform(source):
    subprocess.run([*TRANSFORM, source, "read.ply"], check=True, capture_output=True)


def by_gaussforge(source):
    Path("read.ply").write_bytes(gaussforge.GaussForge().convert(Path(source).read_bytes(), "sog", "ply")["data"])


subprocess.run(["env/bin/python", "-m", "SogPython", "scene.ply", "sogpy.sog"], check=True, capture_output=True)
subprocess.run([*TRANSFORM, "-g", "cpu", "scene.ply", "splat-transform.sog"], check=True, capture_output=True)
places = np.stack([rows[axis] for axis in "xyz"], 1)
for source in ("sogpy.sog", "splat-transform.sog"):
    for read in (by_transform, by_gaussforge):
        read(source)
        found = PlyData.read("read.ply")["vertex"].data
        distance, order = cKDTree(np.stack([found[axis] for axis in "xyz"], 1)).query(places)
        found = found[order]
        plain = np.abs(columns(found, "f_dc_", 3) - columns(rows, "f_dc_", 3)).mean()
        assert distance.max() < 1e-3 and plain < 0.02
        rest = columns(found, "f_rest_", 45)
        shares = (rest**2).reshape(count, 3, 15).sum((0, 2)) / (rest**2).sum()
        print(f"{source} {read.__name__}: red, green, blue have {shares.round(2)} of what depends on the direction")
        wrong = source == "sogpy.sog"
        assert np.allclose(shares, 1 / 3 if wrong else [1, 0, 0], atol=0.1 if wrong else 0.01)
        swapped = kinds.reshape(count, 5, 3)  # triples of what is red, taken for red, green and blue
        expected = np.zeros((count, 3, 15))
        if wrong:
            expected[:, :, :5] = swapped.transpose(0, 2, 1)
        else:
            expected[:, 0] = kinds
        assert np.sqrt(((rest.reshape(count, 3, 15) - expected) ** 2).mean()) < 0.1 * np.sqrt((expected**2).mean())
PYTHON
echo "as described"
