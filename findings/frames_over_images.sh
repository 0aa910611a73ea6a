#!/usr/bin/env bash
# pycolmap 4.2.1: the poses in images.txt are written, and not read, where frames.txt lies beside it.
#
# Since rigs came, a model holds each pose twice: in images.txt, as always, and in frames.txt. Programs that know the
# three old files alone (scripts that scale, turn or cut a model, exporters) rewrite images.txt in place and leave
# frames.txt as it was.
# Seen: all cameras moved by 100 in images.txt: the model is read with its old poses, no warning, no error; with
# frames.txt and rigs.txt taken away, with the new ones. Readers of the old files alone see the new ones in both cases,
# so that two programs open one folder with two sets of cameras. After such an edit, delete both files.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pycolmap==4.2.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
import pycolmap

model = pycolmap.Reconstruction()
model.add_camera_with_trivial_rig(
    pycolmap.Camera(model="PINHOLE", width=60, height=40, params=[50, 50, 30, 20], camera_id=1)
)
for number in range(1, 5):
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0, 0, 0, 1.0])), np.array([float(number), 0, 0]))
    image = pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number)
    model.add_image_with_trivial_frame(image, pose)
folder = Path("model")
folder.mkdir()
model.write_text(str(folder))
assert {"frames.txt", "rigs.txt"} <= {path.name for path in folder.iterdir()}

lines = []
for line in (folder / "images.txt").read_text().splitlines():
    words = line.split()
    if len(words) == 10 and words[0].isdigit():
        words[5] = str(float(words[5]) + 100)
    lines.append(" ".join(words))
(folder / "images.txt").write_text("\n".join(lines) + "\n")


def first():
    return pycolmap.Reconstruction(str(folder)).image(1).cam_from_world().translation[0]


beside = first()
for name in ("frames.txt", "rigs.txt"):
    (folder / name).unlink()
alone = first()
print(f"x of the first camera: {beside} with frames.txt, {alone} without")
assert (beside, alone) == (1.0, 101.0)
PYTHON
echo "as described"
