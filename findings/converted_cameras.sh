#!/usr/bin/env bash
# Cameras of COLMAP converted by camorph 1.0.0 and kapture 1.1.12: which lens is left, and in whose photographs.
#
# Two cameras, f 500 x 520 and the principal point at (300, 200) of 640 x 480: one PINHOLE, and one OPENCV with k1 0.05,
# k2 -0.02, p1 0.001, p2 0.002. Poses survive; of the lens, after camorph has
#   written NeRF (transforms.json)   the first camera's numbers for the file; what differs in a key `intrinsics` of each
#                                    frame. Who reads the file's, or a frame's own `k1` as nerfstudio spells it, gives
#                                    all photographs the first lens. Differences of up to 0.001 are left out: p1 is 0
#   Meshroom, and read it again      the principal point at (620, 440), outside of the picture: 300 and 200 are in the
#                                    file, and are added to the middle when read. f 500 x 500, no distortion
#   LLFF; Unity; MPEG_OMAF           f 500 x 500, no principal point; no lens at all; no distortion
#   RealityCapture (XMP)             AspectRatio 1, where fy / fx is 1.04
# kapture's OpenMVG has f 510, the mean, for both; its OpenSfM refuses PINHOLE. No warning of any of this.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet camorph==1.0.0 kapture==1.1.12 numpy==1.26.4 pillow==13.0.0
mkdir -p model images out
cat > model/cameras.txt <<'TEXT'
1 PINHOLE 640 480 500 520 300 200
2 OPENCV 640 480 500 520 300 200 0.05 -0.02 0.001 0.002
TEXT
cat > model/images.txt <<'TEXT'
1 0.96 0.0 0.28 0.0 0.1 -0.5 0.4 1 a.png
10.5 20.5 1
2 0.8 0.0 0.0 0.6 -1.3 -0.6 0.0 2 b.png
10.5 20.5 1
TEXT
echo "1 0.1 0.2 3.0 255 0 0 0.5 1 0 2 0" > model/points3D.txt
env/bin/python - <<'PYTHON'
import json
import re
import warnings
from pathlib import Path

import camorph.camorph as camorph
import numpy as np
from PIL import Image

for name in ("a.png", "b.png"):
    Image.new("RGB", (640, 480)).save(f"images/{name}")
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    cameras = camorph.read_cameras("COLMAP", "model")
    for camera in cameras:
        camera.source_image = str(Path("images", camera.name).absolute())
        camera.near_far_bounds = (0.1, 100.0)
    files = {
        "NeRF": "out/transforms.json",
        "Meshroom": "out/cameras.sfm",
        "LLFF": "out/poses_bounds.npy",
        "Unity": "out/unity.json",
        "MPEG_OMAF": "out/omaf.json",
        "reality_capture": "out/xmp",
    }
    Path("out/xmp").mkdir()
    for name, file in files.items():
        camorph.write_cameras(name, file, cameras)
    read = {name: camorph.read_cameras(name, file) for name, file in files.items() if name != "reality_capture"}
said = {str(warning.message) for warning in caught}
print("\n".join(sorted(said)))
assert not [text for text in said if re.search("distortion|principal|focal|intrinsic|aspect", text, re.IGNORECASE)]

wanted = [(c.focal_length_px, c.principal_point, c.radial_distortion, c.tangential_distortion) for c in cameras]
assert wanted == [([500, 520], [300, 200], None, None), ([500, 520], [300, 200], [0.05, -0.02], [0.001, 0.002])]
for name, found in read.items():
    for before, after in zip(cameras, found, strict=True):
        turn = min((before.r - after.r).norm, (before.r + after.r).norm)
        assert np.allclose(before.t, after.t, atol=1e-6) and turn < 1e-6
        print(name, after.focal_length_px, after.principal_point, after.radial_distortion, after.tangential_distortion)

scene = json.loads(Path(files["NeRF"]).read_text())
print("transforms.json:", {key: scene[key] for key in ("k1", "k2", "p1", "p2")})
assert all(scene[key] == 0 for key in ("k1", "k2", "p1", "p2")) and scene["fl_y"] == 520
for frame in scene["frames"]:
    print(frame["file_path"], sorted(frame), frame["intrinsics"])
    assert not {"k1", "k2", "p1", "p2", "fl_x"} & set(frame)
assert scene["frames"][1]["intrinsics"] == {"k1": 0.05, "k2": -0.02, "p2": 0.002}
intrinsics = json.loads(Path(files["Meshroom"]).read_text())["intrinsics"]
points = {tuple(intrinsic["principalPoint"]) for intrinsic in intrinsics}
assert points == {("300.0", "200.0")} and [list(c.principal_point) for c in read["Meshroom"]] == [[620, 440]] * 2
assert [list(camera.focal_length_px) for camera in read["Meshroom"] + read["LLFF"]] == [[500, 500]] * 4
assert all(camera.radial_distortion is None for name in list(files)[1:5] for camera in read[name])
assert all(camera.principal_point is None for camera in read["LLFF"])
assert all(camera.focal_length_px is None for camera in read["Unity"])
assert 'AspectRatio="1"' in Path("out/xmp/b.xmp").read_text()
PYTHON
env/bin/kapture_import_colmap -txt model -im images -o kapture -f > log.txt 2>&1
env/bin/kapture_export_openmvg -k kapture -o openmvg -f > log.txt 2>&1
if grep -i -E "focal|intrinsic" log.txt; then exit 1; fi
env/bin/python - <<'PYTHON'
import json

for camera in json.load(open("openmvg/sfm_data.json"))["intrinsics"]:
    data = camera["value"]["ptr_wrapper"]["data"]
    print("OpenMVG:", data)
    assert data.get("value0", data)["focal_length"] == 510
PYTHON
if env/bin/kapture_export_opensfm -k kapture -o opensfm -f > log.txt 2>&1; then exit 1; fi
grep 'Unable to export camera of type "CameraType.PINHOLE"' log.txt
echo "as described"
