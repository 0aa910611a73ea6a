#!/usr/bin/env bash
# EXR of a rendered region: five readers leave out where it lies, one pads it, one is without EXR.
#
# A renderer that is given a region writes its pixels alone (data window) and their place in the whole picture (display
# window). Cameras belong to the whole picture. Seen, for 16 x 12 of 32 x 24 pixels, from column 6 and row 4 on:
#   OpenEXR 3.5.3, OpenImageIO 3.2.2.0, pyexr 0.5.0, Mitsuba 3.9.1   16 x 12; the first two have the place in the header
#   PyAV 18.1.0 (FFmpeg)                    32 x 24, zeros around
#   imageio 2.38.1 beside PyAV              a film of one frame, 32 x 24, 8 bits
#   opencv-python-headless 5.0.0.93         None: built without OpenEXR, whatever OPENCV_IO_ENABLE_OPENEXR says
# A depth channel Z or V alone is read by the first four, and refused by PyAV. Without the place, 6 and 4 are to be taken
# off the principal point; what lies around is zero for some and not there for others.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 OpenEXR==3.5.3 OpenImageIO==3.2.2.0 pyexr==0.5.0 mitsuba==3.9.1 av==18.1.0 \
    imageio==2.38.1 opencv-python-headless==5.0.0.93
env/bin/python - <<'PYTHON'
import os

os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"
import av
import cv2
import imageio.v3 as imageio
import mitsuba
import numpy as np
import OpenEXR
import OpenImageIO
import pyexr

mitsuba.set_variant("scalar_rgb")
region = np.broadcast_to(np.arange(6, 22, dtype=np.float32), (12, 16)).copy()  # each pixel's own column


def write(name, **channels):
    corners = {"dataWindow": ((6, 4), (21, 15)), "displayWindow": ((0, 0), (31, 23))}
    header = {name: tuple(np.array(corner, np.int32) for corner in pair) for name, pair in corners.items()}
    header |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(name)


def by_openexr(name):
    return next(iter(OpenEXR.File(name).channels().values())).pixels


def by_openimageio(name):
    image = OpenImageIO.ImageInput.open(name)
    assert (image.spec().x, image.spec().y, image.spec().full_width) == (6, 4, 32)
    return image.read_image()


def by_mitsuba(name):
    return np.array(mitsuba.Bitmap(name))


write("color.exr", R=region, G=region, B=region)
write("Z.exr", Z=region)
write("V.exr", V=region)
for reader in (by_openexr, by_openimageio, pyexr.read, by_mitsuba):
    for name in ("color.exr", "Z.exr", "V.exr"):
        found = np.asarray(reader(name))
        print(f"{reader.__name__} {name}: {found.shape}")
        assert np.array_equal(found.reshape(12, 16, -1)[..., 0], region)
with av.open("color.exr") as file:
    whole = next(file.decode(video=0)).to_ndarray(format="gbrpf32le")
print("PyAV:", whole.shape, "border", whole[0].max())
assert whole.shape[:2] == (24, 32) and np.array_equal(whole[4:16, 6:22, 0], region) and whole.sum() == 3 * region.sum()
for name in ("Z.exr", "V.exr"):
    try:
        with av.open(name) as file:
            next(file.decode(video=0))
    except av.error.PatchWelcomeError as error:
        print(f"PyAV {name}: {error}")
    else:
        raise AssertionError(name)
film = imageio.imread("color.exr")
print("imageio:", film.shape, film.dtype)
assert film.shape == (1, 24, 32, 3) and film.dtype == np.uint8
print("OpenCV:", cv2.imread("color.exr", cv2.IMREAD_UNCHANGED))
assert cv2.imread("color.exr", cv2.IMREAD_UNCHANGED) is None and cv2.imread("Z.exr", cv2.IMREAD_UNCHANGED) is None
PYTHON
