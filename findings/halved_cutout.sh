#!/usr/bin/env bash
# A cut-out picture made smaller, as half-size views of Blender's synthetic scenes: where a dark rim comes from.
#
# Renderers leave black behind what is transparent. A white disc on such pixels, halved, and then laid on white, where
# nothing of it can be seen. The darkest pixel of 255:
#   Pillow 13.0.0 resize, reduce, thumbnail, rotate; libvips 8.18.7 thumbnail     254 and more
#   OpenCV 5.0.0.93 resize, scikit-image 0.26.0 resize, PyTorch 2.13.0 interpolate, kornia 0.9.0 resize, PyAV 18.1.0
#   reformat, libvips resize and shrink     191: colours are averaged without their alpha, black among them
#   OpenImageIO 3.2.2.0 resize     255 as premultiplied, which its buffers are, and 191 if laid on white as the others'
# No warning. Whoever trains on the half-size views has a dark rim around each object, in the truth. Lay on white first,
# then resize, or multiply by alpha before and divide after.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 numpy==2.4.6 pillow==13.0.0 opencv-python-headless==5.0.0.93 \
    scikit-image==0.26.0 av==18.1.0 OpenImageIO==3.2.2.0 pyvips==3.2.0 pyvips-binary==8.18.7
env/bin/python - <<'PYTHON'
import warnings

import av
import cv2
import kornia
import numpy as np
import OpenImageIO
import pyvips
import torch
from PIL import Image
from skimage.transform import resize

warnings.simplefilter("error", UserWarning)
rows, columns = np.mgrid[:64, :64]
cutout = np.zeros((64, 64, 4), np.uint8)
cutout[np.hypot(rows - 31.5, columns - 31.5) < 20] = 255
image = Image.fromarray(cutout)
image.save("cutout.png")
small = image.copy()
small.thumbnail((32, 32))
tensor = torch.tensor(cutout).permute(2, 0, 1)[None].float() / 255
vips = pyvips.Image.new_from_file("cutout.png")
area = OpenImageIO.ROI(0, 32, 0, 32, 0, 1, 0, 4)
with av.open("cutout.png") as file:
    frame = next(file.decode(video=0))
right = {
    "Pillow, resize BOX": image.resize((32, 32), Image.BOX),
    "Pillow, resize LANCZOS": image.resize((32, 32), Image.LANCZOS),
    "Pillow, reduce": image.reduce(2),
    "Pillow, thumbnail": small,
    "Pillow, rotate": image.rotate(30, Image.BICUBIC),
    "libvips, thumbnail": pyvips.Image.thumbnail("cutout.png", 32).numpy(),
}
rim = {
    "OpenCV": cv2.resize(cutout, (32, 32), interpolation=cv2.INTER_AREA),
    "scikit-image": 255 * resize(cutout, (32, 32), anti_aliasing=True),
    "PyTorch": 255 * torch.nn.functional.interpolate(tensor, scale_factor=0.5, mode="area")[0].permute(1, 2, 0),
    "kornia": 255 * kornia.geometry.resize(tensor, (32, 32), antialias=True)[0].permute(1, 2, 0),
    "PyAV": frame.reformat(32, 32, "rgba").to_ndarray(),
    "libvips, resize": vips.resize(0.5).numpy(),
    "libvips, shrink": vips.shrink(2, 2).numpy(),
}
by_openimageio = OpenImageIO.ImageBufAlgo.resize(OpenImageIO.ImageBuf("cutout.png"), roi=area).get_pixels()


def darkest(pixels, premultiplied=False):
    """The darkest pixel on white, of 255."""
    pixels = np.asarray(pixels, float) / 255
    alpha = pixels[..., 3:]
    return 255 * (pixels[..., :3] * (1 if premultiplied else alpha) + 1 - alpha).min()


for name, pixels in (right | rim).items():
    print(f"{name}: {darkest(pixels):.0f}")
    assert darkest(pixels) > 253.5 if name in right else abs(darkest(pixels) - 191) < 2, name
associated = [darkest(255 * by_openimageio, premultiplied) for premultiplied in (True, False)]
print("OpenImageIO, as premultiplied and as not:", np.round(associated))
assert associated[0] > 254 and abs(associated[1] - 191) < 2
laid = (255 * (tensor[0, :3] * tensor[0, 3:] + 1 - tensor[0, 3:])).permute(1, 2, 0).numpy()
assert cv2.resize(laid, (32, 32), interpolation=cv2.INTER_AREA).min() > 254
PYTHON
echo "as described"
