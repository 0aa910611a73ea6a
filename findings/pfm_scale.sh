#!/usr/bin/env bash
# Depth in PFM, the float images of stereo benchmarks: five programs make four pictures of one file.
#
# Rows are stored from the bottom up, and the third line of the header is a scale, negative for little-endian numbers.
# With a scale of -2.5, Pillow 13.0.0 returns the numbers as stored and 2.5 in `info["scale"]`, in gray alone; OpenCV
# 5.0.0.93 and PyAV 18.1.0 (FFmpeg) divide by it; OpenImageIO 3.2.2.0 multiplies, and returns the bottom row first;
# imageio 2.38.1 beside PyAV decodes it as a film, to 8 bits that end at 1. No warning. With a scale of -1 the
# first three agree: write that, and look which way up it is.
# Seen: 2 x 3 numbers from 1 to 6.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 pillow==13.0.0 opencv-python-headless==5.0.0.93 av==18.1.0 \
    imageio==2.38.1 OpenImageIO==3.2.2.0
env/bin/python -W error - <<'PYTHON'
import av
import cv2
import imageio.v3 as imageio
import numpy as np
import OpenImageIO
from PIL import Image

stored = np.arange(1, 7, dtype="<f4").reshape(2, 3)
for scale in (-2.5, -1.0):
    with open("depth.pfm", "wb") as file:
        file.write(f"Pf\n3 2\n{scale}\n".encode() + stored[::-1].tobytes())

    picture = Image.open("depth.pfm")
    with av.open("depth.pfm", format="image2") as film:
        frame = next(film.decode(video=0)).to_ndarray()
    flipped = OpenImageIO.ImageBuf("depth.pfm").get_pixels(OpenImageIO.FLOAT)[..., 0]
    eight_bits = imageio.imread("depth.pfm")
    opencv = cv2.imread("depth.pfm", cv2.IMREAD_UNCHANGED)
    print(f"scale {scale}: Pillow {np.asarray(picture)[0]}, OpenCV {opencv[0]}, PyAV {frame[0]}, "
          f"OpenImageIO {flipped[0]}, imageio {eight_bits[0, 0, :, 0]}")
    assert (np.asarray(picture) == stored).all() and picture.info["scale"] == -scale
    assert np.allclose(opencv, stored / -scale) and np.allclose(frame, stored / -scale)
    assert np.allclose(flipped, stored[::-1] * -scale)
    assert eight_bits.dtype == np.uint8 and eight_bits.shape == (1, 2, 3, 3)
    assert (eight_bits[0][stored >= -scale] == 255).all()
PYTHON
echo "as described"
