#!/usr/bin/env bash
# Numbers of objects, as masks of renderers hold them, in EXR's UINT and TIFF of 32 bits: where 1, 2 and 3 become 0.
#
# What nine readers make of the numbers 1, 1000, 16777217 and 3000000001, written by OpenEXR 3.5.3 and tifffile:
#   EXR, channel Y or R, G, B     OpenEXR, OpenImageIO's ImageInput     as they are
#     pyexr 0.5.0                                                       1, 1000, 16777216, 3000000000
#     PyAV 18.1.0                                                       0, 0, 256, 45776: the upper 16 bits
#     imageio 2.38.1, its default for EXR                               0, 0, 1, 179, as bytes
#     OpenImageIO 3.2.2.0, ImageBuf's get_pixels()                      2.3e-10, 2.3e-7, 0.004, 0.698
#   TIFF    tifffile, OpenCV, pyvips, imageio                           as they are
#     Pillow 13.0.0                                                     1, 1000, 16777217, -1294967295
#     OpenImageIO's ImageBuf                                            2.3e-10, 2.3e-7, 0.004, 0.698
# So a mask of a few objects is empty, and objects share a number. No warning. PyAV and imageio raise where the channel
# has another name, as `id`. Read EXR by OpenEXR, or by ImageInput as "unknown", and look at the type that comes back.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet OpenEXR==3.5.3 OpenImageIO==3.2.2.0 pyexr==0.5.0 av==18.1.0 imageio==2.38.1 pillow==13.0.0 \
    tifffile==2026.3.3 opencv-python-headless==5.0.0.93 pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import av
import cv2
import imageio.v3 as iio
import numpy as np
import OpenEXR
import OpenImageIO
import pyexr
import pyvips
import tifffile
from PIL import Image

numbers = np.array([[1, 1000, 16777217, 3000000001]], np.uint32).repeat(4, 0)


def write(channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write("numbers.exr")


def by_openexr(name):
    (channel,) = OpenEXR.File(name).channels().values()
    return channel.pixels


def by_pyav(name):
    return next(av.open(name).decode(video=0)).to_ndarray()


def by_input(name):
    return OpenImageIO.ImageInput.open(name).read_image("unknown")


def by_buffer(name):
    return OpenImageIO.ImageBuf(name).get_pixels()


def by_pyvips(name):
    return pyvips.Image.new_from_file(name).numpy()


def by_pillow(name):
    return np.asarray(Image.open(name))


def by_opencv(name):
    return cv2.imread(name, cv2.IMREAD_UNCHANGED)


right, share = numbers[0], numbers[0] / (2**32 - 1)
exr = {
    by_openexr: right, by_input: right, pyexr.read: (1, 1000, 16777216, 3000000000), by_pyav: (0, 0, 256, 45776),
    iio.imread: (0, 0, 1, 179), by_buffer: share,
}
tif = {
    tifffile.imread: right, by_opencv: right, by_pyvips: right, iio.imread: right,
    by_pillow: (1, 1000, 16777217, 3000000001 - 2**32), by_buffer: share,
}


def check(name, ways):
    for way, expected in ways.items():
        found = np.asarray(way(name))
        found = found.reshape(found.shape[1:] if found.ndim == 4 else found.shape).reshape(4, 4, -1)[0, :, 0]
        print(f"{name} {way.__module__:20} {way.__name__:10} {found.dtype!s:8} {found}")
        assert np.allclose(np.asarray(found, float), np.asarray(expected, float), rtol=1e-7, atol=0), way


for channels in ({"Y": numbers}, {"RGB": np.stack([numbers] * 3, -1)}):
    write(channels)
    check("numbers.exr", exr)
tifffile.imwrite("numbers.tif", numbers)
check("numbers.tif", tif)
write({"id": numbers})
for way in (by_pyav, iio.imread):
    try:
        way("numbers.exr")
    except Exception as error:
        print("a channel named id:", way.__name__, type(error).__name__)
    else:
        raise AssertionError(way)
PYTHON
echo "as described"
