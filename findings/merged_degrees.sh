#!/usr/bin/env bash
# Two scenes of other degrees of harmonics merged by splat-transform 3.7.0: colours of the smaller one are others.
#
# As a statue that was fitted with degree 1 is put into a garden of degree 3, `splat-transform a.ply b.ply both.ply`.
# Guessed: by the names of columns; so it is. A PLY has red's coefficients first, then green's and blue's, so that
# what `f_rest_3` means depends on the degree: green's first of degree 1, and red's fourth of degree 3.
# Seen: of a scene whose green alone depends on the direction, red does after it was merged, by functions of degree 2.
# SPZ and the order of files do not change it; the status is 0 and there is no warning. Scenes of one degree, or of
# degree 0, are right. gsply 0.4.6 refuses to join them. Give each larger one `--filter-harmonics N` right behind its
# name, with the smallest degree: then the coefficients that are left are right.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 @playcanvas/splat-transform@3.7.0
python3 -m venv env
env/bin/pip install --quiet gsply==0.4.6 plyfile==1.1.5 numpy==2.3.5
env/bin/python - <<'PYTHON'
import subprocess

import gsply
import numpy as np
from plyfile import PlyData, PlyElement

COMMAND = ["node_modules/node/bin/node", "node_modules/.bin/splat-transform", "-q", "-w"]
COUNT = 100


def write(path, degree, green):
    """Gaussians whose green alone depends on the direction, by one coefficient for each function."""
    functions = (degree + 1) ** 2 - 1
    higher = [f"f_rest_{i}" for i in range(3 * functions)]
    names = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", *higher, "opacity", *(f"scale_{i}" for i in range(3))]
    rows = np.zeros(COUNT, [(name, "f4") for name in (*names, *(f"rot_{i}" for i in range(4)))])
    rows["x"], rows["opacity"], rows["rot_0"] = np.arange(COUNT), 2, 1
    for name in higher[functions : 2 * functions]:
        rows[name] = green
    PlyData([PlyElement.describe(rows, "vertex")]).write(path)


def merged(*words):
    """Coefficients by scene, Gaussian, channel and function."""
    subprocess.run([*COMMAND, *words, "both.ply"], check=True)
    rows = PlyData.read("both.ply")["vertex"]
    count = sum(each.name.startswith("f_rest_") for each in rows.properties)
    return np.stack([rows[f"f_rest_{i}"] for i in range(count)], 1).reshape(2, COUNT, 3, count // 3)


write("zero.ply", 0, 0.0)
write("one.ply", 1, 0.5)
write("three.ply", 3, 0.25)
subprocess.run([*COMMAND, "one.ply", "one.spz"], check=True)
green_one, green_three, nothing = np.zeros((3, 15)), np.zeros((3, 15)), np.zeros((3, 15))
green_one[1, :3], green_three[1] = 0.5, 0.25
spoilt = np.zeros((3, 15))
spoilt[0, 3:6] = 0.5  # red, by the first three functions of degree 2
for words, scenes in (
    (("one.ply", "three.ply"), (spoilt, green_three)),
    (("three.ply", "one.ply"), (green_three, spoilt)),
    (("one.spz", "three.ply"), (spoilt, green_three)),
    (("zero.ply", "three.ply"), (nothing, green_three)),
    (("one.ply", "one.ply"), (green_one[:, :3], green_one[:, :3])),
    (("one.ply", "three.ply", "--filter-harmonics", "1"), (green_one[:, :3], green_three[:, :3])),
):
    found = merged(*words)
    for scene, expected in zip(found, scenes):
        assert np.allclose(scene, expected, atol=0.02), (words, scene[0])
    largest = np.abs(found).max((1, 3)).round(2).tolist()
    print(f"{' '.join(words)}: largest of red, green and blue, by scene {largest}")
try:
    gsply.plyread("one.ply").add(gsply.plyread("three.ply"))
except ValueError as error:
    print(f"gsply: {error}")
else:
    raise SystemExit("gsply joined them")
PYTHON
echo "as described"
