#!/usr/bin/env bash
# Light probes in Radiance's .hdr: what five readers make of what its header says.
#
# A header has the order of rows and columns, whether numbers are RGB or XYZ, and an exposure by which they were
# multiplied, to be divided by. 2 x 3 pixels of up to 4; the right picture is "-Y 3 +X 2", rgbe, exposure 1:
#                                 EXPOSURE=2      +Y 3 +X 2 (bottom     +X 2 -Y 3 (by columns)    xyze
#                                                 row first)
#   OpenImageIO 3.2.2.0           twice as large  upside down           2 rows of 3, transposed   None
#   PyAV 18.1.0 (FFmpeg)          twice as large  upside down           3 rows of 2, scrambled    XYZ, taken for RGB
#   Mitsuba 3.9.1                 twice as large  raises                raises                    XYZ, taken for RGB
#   opencv 5.0.0.93               twice as large  None                  None                      None
#   imageio 2.38.1 beside them    8 bits, all above 1 is white; raises for the others
# OpenImageIO names the order in "Orientation", and has no word of the exposure. No warning. Light from above is then
# light from below. Write "-Y +X", rgbe and no exposure.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet OpenImageIO==3.2.2.0 av==18.1.0 mitsuba==3.9.1 opencv-python-headless==5.0.0.93 \
    imageio==2.38.1 numpy==2.4.6
env/bin/python -W error::UserWarning - 2> log.txt <<'PYTHON'
import av
import cv2
import imageio.v3
import mitsuba
import numpy as np
import OpenImageIO

mitsuba.set_variant("scalar_rgb")
picture = np.array([[[1, 0.5, 0.25], [2, 1, 0.5]], [[0.125, 0.25, 0.5], [4, 4, 1]], [[0.5] * 3, [1, 2, 3]]], "f4")


def write(pixels, size="-Y 3 +X 2", line="", kind="rgbe"):
    exponents = np.frexp(pixels.max(-1))[1]
    mantissas = np.floor(pixels * np.ldexp(256.0, -exponents)[..., None])
    data = np.concatenate([mantissas, exponents[..., None] + 128], -1).astype(np.uint8)
    with open("probe.hdr", "wb") as file:
        file.write(f"#?RADIANCE\n{line}FORMAT=32-bit_rle_{kind}\n\n{size}\n".encode() + data.tobytes())


def by_av():
    with av.open("probe.hdr") as file:
        return next(file.decode(video=0)).to_ndarray()


def by_openimageio():
    file = OpenImageIO.ImageInput.open("probe.hdr")
    if file is None:
        print("   ", OpenImageIO.geterror())
        return None
    header = file.spec()
    print("    Orientation", header.getattribute("Orientation"), "exposure", header.getattribute("EXPOSURE"))
    return file.read_image("float")


def by_opencv():
    found = cv2.imread("probe.hdr", cv2.IMREAD_UNCHANGED)
    return None if found is None else found[..., ::-1]


readers = {
    "OpenImageIO": by_openimageio,
    "PyAV": by_av,
    "Mitsuba": lambda: np.array(mitsuba.Bitmap("probe.hdr")),
    "opencv": by_opencv,
    "imageio": lambda: imageio.v3.imread("probe.hdr"),
}
white = (picture.clip(0, 1) * 255).round()
up, columns = picture[::-1], picture.transpose(1, 0, 2)
for title, options, expected in (
    ("plain", {"pixels": picture}, [picture] * 4 + [white]),
    ("EXPOSURE=2", {"pixels": picture, "line": "EXPOSURE=2\n"}, [picture] * 4 + [white]),
    ("+Y +X", {"pixels": up, "size": "+Y 3 +X 2"}, [up, up, RuntimeError, None, ValueError]),
    (
        "+X -Y",
        {"pixels": columns, "size": "+X 2 -Y 3"},
        [columns, columns.reshape(3, 2, 3), RuntimeError, None, ValueError],
    ),
    ("xyze", {"pixels": picture, "kind": "xyze"}, [None, picture, picture, None, ValueError]),
):
    write(**options)
    print(title)
    for (name, read), right in zip(readers.items(), expected):
        try:
            found = read()
        except (RuntimeError, ValueError) as error:
            found = type(error)
        print(f"  {name:12}", found.tolist() if isinstance(found, np.ndarray) else found)
        if isinstance(right, np.ndarray):
            assert found.shape == right.shape and np.allclose(found, right, atol=1 if name == "imageio" else 0.02)
        else:
            assert found is right
PYTHON
echo "as described"
