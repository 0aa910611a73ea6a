#!/usr/bin/env bash
# Antialiased Gaussians through SOG, by splat-transform 3.7.0 and gaussforge 0.6.0: what one marks, the other ignores.
#
# Public packages of npm and PyPI, run with Node.js 22 of npm. A scene that was trained with antialiasing (opacities
# compensated for a pixel's filter) loses its mark between them: in SOG's meta.json gaussforge writes
# `"antialias": true`, as the format was described in 2025, and splat-transform reads and writes
# `"model": "antialiased"` alone. Through SPZ, whose flag both have, the mark survives.
# Seen: PLY (`comment SplatRenderMode: mip`) to SPZ by splat-transform keeps it; SPZ to SOG by gaussforge has
# `antialias`; back to PLY by splat-transform has no comment, no warning. A viewer then draws thin Gaussians up to
# several times too opaque. A writer of SOG that wants to be understood writes both keys.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 @playcanvas/splat-transform@3.7.0
python3 -m venv env
env/bin/pip install --quiet gaussforge==0.6.0 plyfile==1.1.2 numpy==2.2.6
env/bin/python - <<'PYTHON'
import io
import json
import subprocess
import zipfile
from pathlib import Path

import gaussforge
import numpy as np
from plyfile import PlyData, PlyElement

COMMAND = ["node_modules/node/bin/node", "node_modules/.bin/splat-transform", "-w"]
names = [*("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"), *(f"scale_{i}" for i in range(3))]
rows = np.zeros(100, [(name, "f4") for name in (*names, "rot_0", "rot_1", "rot_2", "rot_3")])
generator = np.random.default_rng(0)
for name in names:
    rows[name] = generator.normal(size=100)
rows["rot_0"] = 1
mark = "SplatRenderMode: mip"
PlyData([PlyElement.describe(rows, "vertex")], comments=[mark]).write("marked.ply")


def convert(source, target):
    subprocess.run([*COMMAND, source, target], check=True, capture_output=True)


convert("marked.ply", "marked.spz")
sog = bytes(gaussforge.GaussForge().convert(Path("marked.spz").read_bytes(), "spz", "sog")["data"])
Path("theirs.sog").write_bytes(sog)
meta = json.loads(zipfile.ZipFile(io.BytesIO(sog)).read("meta.json"))
convert("marked.spz", "from_spz.ply")
convert("theirs.sog", "from_sog.ply")
kept = {name: mark in PlyData.read(f"from_{name}.ply").comments for name in ("spz", "sog")}
print(f"gaussforge's SOG: antialias {meta.get('antialias')}, model {meta.get('model')}; splat-transform kept it: {kept}")
assert meta.get("antialias") is True and "model" not in meta, "gaussforge writes other keys now"
assert kept == {"spz": True, "sog": False}, "splat-transform reads the mark of SOG now"
PYTHON
