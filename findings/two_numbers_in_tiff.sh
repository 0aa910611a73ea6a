#!/usr/bin/env bash
# Two numbers a pixel in TIFF, as of optical flow: OpenCV and Pillow give one of them, SimpleITK a mixture, silently.
#
# 5 x 4 pixels, as of optical flow, or of depth with its confidence, contiguous, with one extra sample that is not
# specified, as tifffile 2026.3.3 writes them. What comes back:
#                                      2 x uint8          2 x uint16          2 x float32        2 x float16
#   imageio 2.38.0 (by tifffile)       right              right               right              right
#   pyvips 3.2.0 (libvips 8.18.7)      right              right               right              right, as float32
#   OpenImageIO 3.2.2                  right, as float    right, as float     right              right, as float
#   OpenCV 5.0.0.93, UNCHANGED         the first          the first / 256,    None               None
#                                                         as bytes
#   Pillow 13.0.0                      the first          raises              raises             raises
#   SimpleITK 2.5.7                    mixed              mixed               mixed              mixed, as integers
# "Mixed" is a picture of one number a pixel, of the right size: u, v, u, v ... of each row, up to its width, so that it
# shows the left half, striped. No warning by any of the three. With an extra sample that is said to be alpha, as by
# extrasamples=("unassalpha",), OpenImageIO multiplies the first by the second: u is -0.47 for -1.88 where v is 0.25.
# Store the two as an EXR of two channels, as .npy, or as two files.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet tifffile==2026.3.3 imageio==2.38.0 pyvips==3.2.0 pyvips-binary==8.18.7 \
  OpenImageIO==3.2.2.0 opencv-python-headless==5.0.0.93 pillow==13.0.0 SimpleITK==2.5.7 numpy==2.4.6
OPENCV_LOG_LEVEL=OFF env/bin/python -W error - <<'PYTHON'
import cv2
import imageio.v3
import numpy as np
import OpenImageIO as oiio
import pyvips
import SimpleITK as sitk
import tifffile
from PIL import Image, UnidentifiedImageError

place = np.arange(20.0).reshape(4, 5)
flow = np.stack([(place - 7.5) / 4, 2 * place + 0.25], axis=-1)
levels = np.stack([5 * place + 1, 250 - 3 * place], axis=-1)
PICTURES = {"uint8": levels.astype(np.uint8), "uint16": (257 * levels).astype(np.uint16),
            "float32": flow.astype(np.float32), "float16": flow.astype(np.float16)}


def by_pillow(path):
    try:
        return np.asarray(Image.open(path))
    except UnidentifiedImageError:
        return None


def by_openimageio(path):
    return oiio.ImageInput.open(path).read_image()


for name, truth in PICTURES.items():
    path, whole = f"{name}.tif", truth.dtype.kind == "u"
    tifffile.imwrite(path, truth, photometric="minisblack", planarconfig="contig", extrasamples=("unspecified",))
    assert np.array_equal(imageio.v3.imread(path), truth)
    assert np.array_equal(pyvips.Image.new_from_file(path).numpy(), truth)
    largest = np.iinfo(truth.dtype).max if whole else 1
    assert np.allclose(by_openimageio(path), truth / largest, atol=1e-6)
    first = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    print(f"{name}: OpenCV {first if first is None else (first.dtype, first[0].tolist())}")
    if whole:
        assert first.dtype == np.uint8 and np.array_equal(first, truth[..., 0] // (257 if name == "uint16" else 1))
    else:
        assert first is None
    shown = by_pillow(path)
    print(f"{name}: Pillow {shown if shown is None else shown[0].tolist()}")
    assert np.array_equal(shown, truth[..., 0]) if name == "uint8" else shown is None
    mixed = sitk.GetArrayFromImage(sitk.ReadImage(path))
    print(f"{name}: SimpleITK {mixed.dtype} {mixed[0].tolist()} for {truth[0].tolist()}")
    stored = truth.view(np.uint16) if name == "float16" else truth
    assert mixed.shape == (4, 5) and np.array_equal(mixed, stored.reshape(4, 10)[:, :5])

tifffile.imwrite("alpha.tif", PICTURES["float32"], photometric="minisblack", extrasamples=("unassalpha",))
multiplied = by_openimageio("alpha.tif")
print(f"OpenImageIO with alpha: {multiplied[0, 0]} for {flow[0, 0]}")
assert np.allclose(multiplied[..., 0], flow[..., 0] * flow[..., 1], atol=1e-6)
assert np.array_equal(multiplied[..., 1], flow[..., 1])
PYTHON
echo "as described"
