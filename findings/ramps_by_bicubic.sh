#!/usr/bin/env bash
# A ramp made larger by "bicubic", as depth or texture coordinates are: five functions bend it, by up to 0.09 of a step.
#
# Rows of 0, 1, 2 ..., so that the pixel i of a picture twice (and four times) as large should hold (i + 0.5) / 2 - 0.5,
# away from the sides. The largest error, in steps between two pixels of the small picture:
#                                                            twice     four times
#   torch 2.13.0 interpolate(mode="bicubic"), grid_sample    0.047     0.041
#   the same interpolate with antialias=True                 0         0
#   kornia 0.9.0 resize, with antialias=True as well         0.047     0.041
#   opencv 5.0.0.93 INTER_CUBIC                              0.047     0.041
#   Pillow 12.3.0 Image.resize, BICUBIC                      0         0
#   Pillow Image.transform, BICUBIC                          0.094     0.082
#   OpenCV INTER_LANCZOS4; Pillow LANCZOS                    0.014, 0.020; 0.012, 0.016
#   SciPy 1.17.1 zoom(order=3); bilinear by torch, OpenCV, Pillow     0 (0.0002)
# The kernels are Keys' with a = -0.75, -0.5 and -1, of which -0.5 alone keeps straight lines; the names do not say
# which. antialias=True changes the kernel, though nothing is made smaller. No warning: slopes of such a depth, and so
# its normals, have stripes. Take bilinear, or torch's antialias=True, for what is measured.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 opencv-python-headless==5.0.0.93 pillow==12.3.0 scipy==1.17.1 \
    numpy==2.4.6 setuptools==80.9.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import cv2
import kornia
import numpy as np
import torch
from PIL import Image
from scipy import ndimage
from torch.nn.functional import grid_sample, interpolate

SIDE = 32
ramp = np.tile(np.arange(SIDE, dtype=np.float32), (SIDE, 1))
tensor, picture = torch.tensor(ramp)[None, None], Image.fromarray(ramp)
CUBIC = Image.Resampling.BICUBIC


def sampled(side):
    line = (torch.arange(side) + 0.5) / side * 2 - 1
    y, x = torch.meshgrid(line, line, indexing="ij")
    return grid_sample(tensor, torch.stack([x, y], -1)[None], mode="bicubic", align_corners=False)


def kornia_resize(side, **options):
    return kornia.geometry.resize(tensor, (side, side), interpolation="bicubic", **options)


def by_opencv(flag):
    return lambda side: cv2.resize(ramp, (side, side), interpolation=flag)


def affine(side):
    step = SIDE / side
    return picture.transform((side, side), Image.Transform.AFFINE, (step, 0, 0, 0, step, 0), CUBIC)


ways = {
    "torch bicubic": (lambda side: interpolate(tensor, (side, side), mode="bicubic"), 0.0469, 0.0410),
    "torch bicubic, antialias": (
        lambda side: interpolate(tensor, (side, side), mode="bicubic", antialias=True), 0, 0),
    "torch grid_sample bicubic": (sampled, 0.0469, 0.0410),
    "torch bilinear": (lambda side: interpolate(tensor, (side, side), mode="bilinear"), 0, 0),
    "kornia bicubic": (kornia_resize, 0.0469, 0.0410),
    "kornia bicubic, antialias": (lambda side: kornia_resize(side, antialias=True), 0.0469, 0.0410),
    "OpenCV cubic": (by_opencv(cv2.INTER_CUBIC), 0.0469, 0.0410),
    "OpenCV Lanczos": (by_opencv(cv2.INTER_LANCZOS4), 0.0145, 0.0117),
    "OpenCV linear": (by_opencv(cv2.INTER_LINEAR), 0, 0),
    "Pillow resize, bicubic": (lambda side: picture.resize((side, side), CUBIC), 0, 0),
    "Pillow resize, Lanczos": (lambda side: picture.resize((side, side), Image.Resampling.LANCZOS), 0.0198, 0.0159),
    "Pillow resize, bilinear": (lambda side: picture.resize((side, side), Image.Resampling.BILINEAR), 0, 0),
    "Pillow transform, bicubic": (affine, 0.0938, 0.0820),
    "SciPy zoom": (lambda side: ndimage.zoom(ramp, side // SIDE, order=3, grid_mode=True, mode="mirror"), 0, 0),
}
for name, (way, *expected) in ways.items():
    errors = []
    for times in (2, 4):
        found = np.asarray(way(times * SIDE)).reshape(times * SIDE, times * SIDE)
        right = (np.arange(times * SIDE) + 0.5) / times - 0.5
        inner = slice(6 * times, -6 * times)
        errors.append(np.abs(found - right)[inner, inner].max())
    print(f"{name:26} {errors[0]:.4f} {errors[1]:.4f}")
    assert np.allclose(errors, expected, atol=4e-4), name
PYTHON
echo "as described"
