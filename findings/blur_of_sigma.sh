#!/usr/bin/env bash
# A Gaussian blur of a given sigma, as before a picture is made smaller: sharp and pyvips do nothing where it is 0.5.
#
# An edge from 0 to 255 was blurred, and the standard deviation of its slope measured, which is sigma:
#   sigma                                                   0.5     1       2       5
#   scikit-image 0.26.0, OpenCV 5.0.0.93                    0.46    1.00    2.00    4.9 to 5.0
#   Pillow 13.0.0, `radius`                                 0.49    0.99    2.00    5.01
#   ffmpeg, PyAV 18.1.0, gblur                              0.48    0.98    1.98    4.99
#   pyvips 8.18, gaussblur(sigma)                           0       0.74    1.62    4.05
#   sharp 0.35.5, blur(sigma)                               0       0.74    1.62    4.05
#           with minAmplitude: 0.01, precision: "float"     0.46    1.00    1.98    4.97
#   jimp 1.6.1, gaussian(r), r being whole                  -       1.6     2.9     6.8
# libvips ends its mask where the bell is below 0.2 of its height, at 1.8 sigma, and what is left is a fifth narrower.
# Of sigma 0.5 the middle alone is left, which is the same picture. Blurred by one library for training and by another
# for a page, pictures differ by this alone. No warning. Pass min_ampl=0.01, and minAmplitude as above.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pyvips==3.2.0 pyvips-binary==8.18.7 opencv-python-headless==5.0.0.93 pillow==13.0.0 \
    scikit-image==0.26.0 av==18.1.0 numpy==2.4.6
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 sharp@0.35.5 jimp@1.6.1
cat > blur.mjs <<'NODE'
import { Jimp } from "jimp";
import sharp from "sharp";
const rows = {};
const row = (bytes, step) => Array.from({ length: 101 }, (_, x) => bytes[step * (50 * 101 + x)]);
for (const sigma of [0.5, 1, 2, 5]) {
  const narrow = await sharp("edge.png").blur(sigma).extractChannel(0).raw().toBuffer();
  const wide = await sharp("edge.png").blur({ sigma, minAmplitude: 0.01, precision: "float" })
    .extractChannel(0).raw().toBuffer();
  rows[sigma] = [row(narrow, 1), row(wide, 1)];
  if (sigma >= 1) rows[sigma].push(row((await Jimp.read("edge.png")).gaussian(sigma).bitmap.data, 4));
}
console.log(JSON.stringify(rows));
NODE
env/bin/python -W error::UserWarning - <<'PYTHON'
import json
import subprocess

import av
import cv2
import numpy as np
import pyvips
from PIL import Image, ImageFilter
from skimage.filters import gaussian

edge = np.zeros((101, 101), np.uint8)
edge[:, 51:] = 255
cv2.imwrite("edge.png", edge)


def width(row):
    slope = np.diff(np.asarray(row, float))
    place = np.arange(len(slope))
    middle = (place * slope).sum() / slope.sum()
    return np.sqrt(((place - middle) ** 2 * slope).sum() / slope.sum())


def by_ffmpeg(sigma):
    graph = av.filter.Graph()
    source = graph.add_buffer(width=101, height=101, format="gray", time_base="1/25")
    blur, sink = graph.add("gblur", f"sigma={sigma}"), graph.add("buffersink")
    source.link_to(blur)
    blur.link_to(sink)
    graph.configure()
    graph.push(av.VideoFrame.from_ndarray(edge, format="gray"))
    return graph.pull().to_ndarray()


ways = {
    "scikit-image": (lambda sigma: gaussian(edge.astype(float), sigma), (0.46, 1, 2, 5)),
    "OpenCV": (lambda sigma: cv2.GaussianBlur(edge, (0, 0), sigma), (0.46, 1, 2, 4.94)),
    "Pillow": (lambda sigma: Image.fromarray(edge).filter(ImageFilter.GaussianBlur(sigma)), (0.49, 0.99, 2, 5.01)),
    "ffmpeg": (by_ffmpeg, (0.48, 0.98, 1.98, 4.99)),
    "pyvips": (lambda sigma: pyvips.Image.new_from_array(edge).gaussblur(sigma).numpy(), (0, 0.74, 1.62, 4.05)),
    "pyvips, min_ampl=0.01": (
        lambda sigma: pyvips.Image.new_from_array(edge).gaussblur(sigma, min_ampl=0.01).numpy(),
        (0.47, 0.97, 1.95, 4.96),
    ),
}
for name, (way, expected) in ways.items():
    found = [width(np.asarray(way(sigma), float).squeeze()[50]) for sigma in (0.5, 1, 2, 5)]
    print(f"{name:23}", np.round(found, 2))
    assert np.allclose(found, expected, atol=0.03), name
run = subprocess.run(["node_modules/.bin/node", "blur.mjs"], capture_output=True, text=True, check=True)
rows = json.loads(run.stdout)
ordered = [rows[sigma] for sigma in sorted(rows, key=float)]
for column, (name, expected) in enumerate((
    ("sharp", (0, 0.74, 1.62, 4.05)), ("sharp, minAmplitude", (0.46, 1, 1.98, 4.97)), ("jimp", (1.6, 2.9, 6.8)),
)):
    found = [width(parts[column]) for parts in ordered if column < len(parts)]
    print(f"{name:23}", np.round(found, 2))
    assert np.allclose(found, expected, atol=0.05), name
untouched = np.array_equal(pyvips.Image.new_from_array(edge).gaussblur(0.5).numpy().squeeze(), edge)
print("pyvips, sigma 0.5: the same picture,", untouched)
assert untouched and rows["0.5"][0] == edge[50].tolist()
PYTHON
echo "as described"
