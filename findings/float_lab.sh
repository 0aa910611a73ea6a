#!/usr/bin/env bash
# OpenCV 5.0.0.93: CIELAB of pictures of floats has 513 levels of lightness, and no colour beyond 1; kornia has all.
#
# `cvtColor` with COLOR_RGB2Lab of float32, beside scikit-image 0.26.0 in double precision:
#                                                       OpenCV           kornia 0.9.0
#   levels of L* in a ramp of 4096 greys                513              4096
#       of 500 greys from 0 to 0.05, as of a shadow     26               500
#   largest a*, b* of these greys                       0.125            0.01
#   mean difference (Delta E) of random colours         0.15             less than 0.001
#   there and back, largest difference                  0.005, 1.3 levels of 255; kornia's less than 0.0001
#   (1.2, 0.9, 0.3)                                     91, -7, 74       96, 14, 80, as of scikit-image
#   (2, 1.5, 1.2)                                       100, 0, 0        151, 32, 50
# Transfers of colours in Lab then have bands, and highlights of a render no colour. No warning. COLOR_LRGB2Lab of
# linear values is within 0.004 on average, COLOR_RGB2Luv within 0.02 and exact there and back; both end at 1, too.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 opencv-python-headless==5.0.0.93 \
    scikit-image==0.26.0 numpy==2.4.6
env/bin/python - <<'PYTHON'
import cv2
import kornia
import numpy as np
import torch
from skimage.color import rgb2lab, rgb2luv


def by_kornia(picture):
    return kornia.color.rgb_to_lab(torch.tensor(picture).permute(2, 0, 1)[None])[0].permute(1, 2, 0).numpy()


def by_opencv(picture, code=cv2.COLOR_RGB2Lab):
    return cv2.cvtColor(picture, code)


def greys(last, count):
    return np.repeat(np.linspace(0, last, count, dtype=np.float32)[None, :, None], 3, axis=2)


for name, convert, ramp, shadow, chroma in (("OpenCV", by_opencv, 513, 26, 0.125), ("kornia", by_kornia, 4096, 500, 0)):
    lightness = [len(np.unique(convert(picture)[..., 0])) for picture in (greys(1, 4096), greys(0.05, 500))]
    found = np.abs(convert(greys(1, 4096))[..., 1:]).max()
    print(f"{name}: levels {lightness}, largest a and b of greys {found:.4f}")
    assert lightness == [ramp, shadow] and abs(found - chroma) < 0.01

colours = np.random.default_rng(0).uniform(0, 1, (200, 200, 3)).astype(np.float32)
true = rgb2lab(colours.astype(float))
difference = {f.__name__: np.linalg.norm(f(colours) - true, axis=2).mean() for f in (by_opencv, by_kornia)}
linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4).astype(np.float32)
difference["linear"] = np.linalg.norm(by_opencv(linear, cv2.COLOR_LRGB2Lab) - true, axis=2).mean()
luv = by_opencv(colours, cv2.COLOR_RGB2Luv)
difference["Luv, largest"] = np.abs(luv - rgb2luv(colours.astype(float))).max()
print({name: round(float(value), 5) for name, value in difference.items()})
assert 0.13 < difference["by_opencv"] < 0.17 and difference["by_kornia"] < 0.001
assert difference["linear"] < 0.004 and difference["Luv, largest"] < 0.02
back = np.abs(by_opencv(by_opencv(colours), cv2.COLOR_Lab2RGB) - colours).max()
lab = torch.tensor(by_kornia(colours)).permute(2, 0, 1)[None]
back_kornia = np.abs(kornia.color.lab_to_rgb(lab)[0].permute(1, 2, 0).numpy() - colours).max()
back_luv = np.abs(by_opencv(luv, cv2.COLOR_Luv2RGB) - colours).max()
print(f"there and back: OpenCV {back:.5f}, kornia {back_kornia:.6f}, OpenCV's Luv {back_luv:.6f}")
assert 0.0045 < back < 0.0055 and back_kornia < 1e-4 and back_luv < 1e-4

bright = ((1.2, 0.9, 0.3), (91, -7, 74), (96, 14, 80)), ((2, 1.5, 1.2), (100, 0, 0), (151, 32, 50))
for colour, opencv, right in bright:
    pixel = np.float32(colour).reshape(1, 1, 3)
    found = [np.ravel(convert(pixel)) for convert in (by_opencv, by_kornia, rgb2lab)]
    print(colour, *(values.round(1) for values in found))
    assert np.allclose(found[0], opencv, atol=0.6) and np.allclose(found[1:], [right, right], atol=0.6)
    for there, again in ((cv2.COLOR_LRGB2Lab, cv2.COLOR_Lab2LRGB), (cv2.COLOR_RGB2Luv, cv2.COLOR_Luv2RGB)):
        assert cv2.cvtColor(cv2.cvtColor(pixel, there), again).max() < 1.001
PYTHON
echo "as described"
