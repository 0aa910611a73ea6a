#!/usr/bin/env bash
# Depth of 12 bits, as of sensors, in AVIF, JPEG 2000 and PGM: eight readers, and four numbers for one.
#
# 4096 depths, 0 to 4095, without loss: AVIF and JPEG 2000 of 12 bits, PGM with a maxval of 4095. What 4095 becomes:
#                                                   AVIF              JPEG 2000    PGM
#   OpenCV 5.0.0.93, IMREAD_UNCHANGED               4095              4095         4095
#   imagecodecs 2026.3.6                            4095              4095         -
#   PyAV 18.1.0, in the frame's own format          4095              65520        65535
#   OpenImageIO 3.2.2.0                             -                 65535        65535
#   Pillow 13.0.0, imageio 2.38.1                   255, of bytes     65520        65535
#   pyvips 8.18                                     65520             -            -
#   sharp 0.35.5, raw({ depth: "ushort" })          255               -            -
#           with toColourspace("grey16")            65520             -            -
# 65520 is 16 times as much, 65535 16.004 times. Beyond reading: pillow-heif 1.8.1 and pyvips write 16 bits to HEIF and
# AVIF that they call lossless (`quality=-1`, `lossless=True`), and 1024 and 4096 levels are left. No warning. Keep
# depth in PNG or TIFF, as 16 bits with a largest number of 65535, and say its scale beside it.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet imagecodecs==2026.3.6 pillow==13.0.0 pillow-heif==1.8.1 imageio==2.38.1 av==18.1.0 \
    opencv-python-headless==5.0.0.93 OpenImageIO==3.2.2.0 pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 sharp@0.35.5
cat > read.mjs <<'NODE'
import sharp from "sharp";
const largest = async (image) => {
  const { buffer, byteOffset, length } = await image.raw({ depth: "ushort" }).toBuffer();
  return Math.max(...new Uint16Array(buffer, byteOffset, length / 2));
};
console.log(await largest(sharp("depth.avif")), await largest(sharp("depth.avif").toColourspace("grey16")));
NODE
env/bin/python -W error::UserWarning - <<'PYTHON'
import subprocess
from pathlib import Path

import av
import cv2
import imagecodecs
import imageio.v3 as iio
import numpy as np
import OpenImageIO
import pillow_heif
import pyvips
from PIL import Image

depth = np.arange(4096, dtype=np.uint16).reshape(64, 64)
Path("depth.avif").write_bytes(imagecodecs.avif_encode(depth, level=100, bitspersample=12))
Path("depth.jp2").write_bytes(imagecodecs.jpeg2k_encode(depth, codecformat="jp2", bitspersample=12))
Path("depth.pgm").write_bytes(b"P5\n64 64\n4095\n" + depth.astype(">u2").tobytes())


def by_pyav(name):
    frame = next(av.open(name).decode(video=0))
    return frame.to_ndarray(format=frame.format.name)


ways = {
    "OpenCV": lambda name: cv2.imread(name, cv2.IMREAD_UNCHANGED),
    "imagecodecs": imagecodecs.imread,
    "PyAV": by_pyav,
    "OpenImageIO": lambda name: OpenImageIO.ImageInput.open(name).read_image("unknown"),
    "Pillow": lambda name: np.asarray(Image.open(name)),
    "imageio": iio.imread,
    "pyvips": lambda name: pyvips.Image.new_from_file(name).numpy(),
}
expected = {
    "avif": {"OpenCV": 4095, "imagecodecs": 4095, "PyAV": 4095, "Pillow": 255, "imageio": 255, "pyvips": 65520},
    "jp2": {
        "OpenCV": 4095, "imagecodecs": 4095, "PyAV": 65520, "OpenImageIO": 65535, "Pillow": 65520, "imageio": 65520,
    },
    "pgm": {"OpenCV": 4095, "PyAV": 65535, "OpenImageIO": 65535, "Pillow": 65535, "imageio": 65535},
}
for kind, readers in expected.items():
    for name, largest in readers.items():
        found = np.asarray(ways[name](f"depth.{kind}"))
        found = (found[..., 0] if found.ndim == 3 else found).astype(float)
        print(f"{kind:5} {name:12} {found.max():.0f}")
        assert found.max() == largest and np.abs(found - depth * (largest / 4095)).max() < 1, (kind, name)
run = subprocess.run(["node_modules/.bin/node", "read.mjs"], capture_output=True, text=True, check=True)
print("avif  sharp       ", run.stdout.strip())
assert run.stdout.split() == ["255", "65520"]

whole = np.arange(65536, dtype=np.uint16).reshape(256, 256)
pillow_heif.encode("I;16", (256, 256), whole.tobytes(), "whole.heic", quality=-1)
read = np.asarray(pillow_heif.open_heif("whole.heic", convert_hdr_to_8bit=False))
pyvips.Image.new_from_array(whole).write_to_file("whole.avif", lossless=True)
other = pyvips.Image.new_from_file("whole.avif").numpy()[..., 0]
for name, back, levels in (("pillow-heif", read, 1024), ("pyvips", other, 4096)):
    error = np.abs(back.astype(int) - whole).max()
    print(f"{name}, written without loss: {len(np.unique(back))} levels of 65536, an error of up to {error}")
    assert len(np.unique(back)) == levels and error <= 65536 // levels
PYTHON
echo "as described"
