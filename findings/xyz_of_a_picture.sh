#!/usr/bin/env bash
# XYZ of the same picture by four packages: two take sRGB for linear, and one of these contradicts its own Lab.
#
# A grey of 0.5 on a screen has the luminance 0.214:
#   scikit-image 0.26.0 rgb2xyz, colour-science 0.4.7 sRGB_to_XYZ    Y 0.214
#   kornia 0.9.0 rgb_to_xyz, opencv 5.0.0.93 COLOR_RGB2XYZ           Y 0.500
# L* of that grey by kornia's rgb_to_lab is 53.4, as it should be, and 76.1 by the formula from its rgb_to_xyz. XYZ of
# scikit-image, made RGB by kornia, is 0.19 off on average. A white balance by Bradford's matrix, from tungsten (A) to
# daylight (D65), makes an orange wall of (0.8, 0.6, 0.4) into (0.58, 0.65, 0.75) by scikit-image, and into (0.29, 0.70,
# 1.44) by kornia. No warning. Apply kornia's rgb_to_linear_rgb before: then all are equal.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 opencv-python-headless==5.0.0.93 scikit-image==0.26.0 \
    colour-science==0.4.7 numpy==2.4.6
env/bin/python - 2> log.txt <<'PYTHON'
import colour
import cv2
import kornia.color
import numpy as np
import torch
from skimage.color import rgb2xyz, xyz2rgb


def tensor(colours):
    return torch.tensor(np.asarray(colours, float)).T[None, :, :, None]


def array(found):
    return found[0, :, :, 0].T.numpy()


def by_kornia(colours, change=kornia.color.rgb_to_xyz):
    return array(change(tensor(colours)))


def by_opencv(colours):
    return cv2.cvtColor(np.asarray(colours, np.float32)[None], cv2.COLOR_RGB2XYZ)[0]


grey = np.full((1, 3), 0.5)
readers = {"scikit-image": rgb2xyz, "colour": colour.sRGB_to_XYZ, "kornia": by_kornia, "opencv": by_opencv}
for name, read in readers.items():
    print(f"{name:13} grey {read(grey)[0].round(3)}")
    assert abs(read(grey)[0, 1] - (0.214 if name in ("scikit-image", "colour") else 0.5)) < 1e-3
lightness = 116 * np.cbrt(by_kornia(grey)[0, 1]) - 16
lab = by_kornia(grey, kornia.color.rgb_to_lab)[0, 0]
print(f"kornia, L* {lab:.1f} by rgb_to_lab, {lightness:.1f} of rgb_to_xyz")
assert abs(lab - 53.4) < 0.1 and abs(lightness - 76.1) < 0.1
colours = np.random.default_rng(0).uniform(size=(500, 3))
found = {name: read(colours) for name, read in readers.items()}
assert np.allclose(found["scikit-image"], found["colour"], atol=5e-4)
assert np.allclose(found["kornia"], found["opencv"], atol=1e-5)
across = np.abs(by_kornia(rgb2xyz(colours), kornia.color.xyz_to_rgb) - colours).mean()
print(f"scikit-image's XYZ to RGB by kornia: {across:.2f} off on average")
assert abs(across - 0.19) < 0.01
linear = by_kornia(by_kornia(colours, kornia.color.rgb_to_linear_rgb))
assert np.allclose(linear, found["scikit-image"], atol=1e-3)
print(f"kornia after rgb_to_linear_rgb: {np.abs(linear - found['scikit-image']).max():.5f} off at most")

white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]
ends = [colour.xy_to_XYZ(white[light]) for light in ("A", "D65")]
balance = colour.adaptation.matrix_chromatic_adaptation_VonKries(*ends, transform="Bradford")
wall = np.array([[0.8, 0.6, 0.4]])
right = xyz2rgb(rgb2xyz(wall) @ balance.T)[0]
other = by_kornia(by_kornia(wall) @ balance.T, kornia.color.xyz_to_rgb)[0]
print("wall, balanced", right.round(2), other.round(2))
assert np.allclose(right, [0.58, 0.65, 0.75], atol=0.01) and np.allclose(other, [0.29, 0.70, 1.44], atol=0.01)
PYTHON
cat log.txt
echo "as described"
