#!/usr/bin/env bash
# Frames that any reader of films gives are a level too dark, and 2.4 dB further from what was filmed than the film is.
#
# Two photographs of scikit-image (512x512 and 600x400 pixels) and a grey one as H.264 of nearly no loss (yuv420p, crf 4;
# nothing tagged, or BT.709), read again. Mean difference from the picture in levels of 255, and PSNR:
#                                                                 photographs           a grey one
#   imageio-ffmpeg 0.8.0, which runs ffmpeg 9.0.2, OpenCV 5.0.0,
#   PyAV 18.1.0, imageio 2.38.0 with it, decord 0.6.0, all the
#   same bit for bit                                              -1.0 to -1.2, 38 dB   -0.5, 49.3 dB
#   the same ffmpeg with -vf scale=flags=bicubic+accurate_rnd
#   +full_chroma_int, and that filter in PyAV                      0.0, 40.1 to 40.8     0.0, 51.7
#   PyAV, interpolation=BICUBIC | ACCURATE_RND | FULL_CHR_H_INT    0.0, 39.0 to 39.3     0.0, 51.7
# All readers convert by libswscale, whose quick way from 4:2:0 to 8-bit RGB truncates and repeats chroma; the flags
# for the exact one are off by default.
# In PyAV, to_ndarray, to_image and reformat take them since 18, but place chroma half a pixel aside, where the filter
# knows that it lies at the left; av.filter.Graph has it. A PSNR between frames and renders has a ceiling by this.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 scikit-image==0.26.0 av==18.1.0 opencv-python-headless==5.0.0.93 \
  imageio==2.38.0 imageio-ffmpeg==0.8.0 decord==0.6.0
env/bin/python - 2> log.txt <<'PYTHON'
import subprocess
from fractions import Fraction

import av
import cv2
import decord
import imageio.v3 as imageio
import imageio_ffmpeg
import numpy as np
from av.video.reformatter import Interpolation
from skimage import data

PROGRAM = imageio_ffmpeg.get_ffmpeg_exe()
EXACT = "scale=flags=bicubic+accurate_rnd+full_chroma_int"
FLAGS = Interpolation.BICUBIC | Interpolation.ACCURATE_RND | Interpolation.FULL_CHR_H_INT
RAW = ("-f", "rawvideo", "-pix_fmt", "rgb24")
grey = np.repeat(data.camera()[..., None], 3, axis=-1)


def ffmpeg(*arguments, **options):
    return subprocess.run([PROGRAM, "-v", "error", "-y", *arguments], check=True, capture_output=True, **options).stdout


def by_pyav(**options):
    with av.open("film.mp4") as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24", **options)


def by_filter():
    with av.open("film.mp4") as container:
        frame = next(container.decode(video=0))
    graph = av.filter.Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=Fraction(1))
    filters = [graph.add("scale", EXACT.removeprefix("scale=")), graph.add("format", "rgb24"), graph.add("buffersink")]
    graph.link_nodes(source, *filters).configure()
    graph.push(frame)
    return graph.pull().to_ndarray()


for picture, dark, found in ((data.astronaut(), -1.05, (38.2, 39.2, 40.65)), (data.coffee(), -1.15, (37.85, 39.1, 40.25)),
                             (grey, -0.5, (49.3, 51.7, 51.7))):
    height, width, _ = picture.shape
    for matrix in ((), ("-vf", f"{EXACT}:out_color_matrix=bt709", "-colorspace", "bt709")):
        film = ("-s", f"{width}x{height}", "-i", "-", *matrix, "-c:v", "libx264", "-crf", "4", "-pix_fmt", "yuv420p")
        ffmpeg(*RAW, *film, "film.mp4", input=picture.tobytes() * 3)
        exact = np.frombuffer(ffmpeg("-i", "film.mp4", "-vf", EXACT, "-frames:v", "1", *RAW, "-"), np.uint8)
        frames = {
            "imageio-ffmpeg": (imageio.imread("film.mp4", plugin="FFMPEG")[0], dark, found[0]),
            "imageio": (imageio.imread("film.mp4", plugin="pyav")[0], dark, found[0]),
            "OpenCV": (cv2.VideoCapture("film.mp4", cv2.CAP_FFMPEG).read()[1][..., ::-1], dark, found[0]),
            "decord": (decord.VideoReader("film.mp4")[0].asnumpy(), dark, found[0]),
            "PyAV": (by_pyav(), dark, found[0]),
            "PyAV, flags": (by_pyav(interpolation=FLAGS), 0, found[1]),
            "PyAV, filter": (by_filter(), 0, found[2]),
            "ffmpeg, flags": (exact.reshape(picture.shape), 0, found[2]),
        }
        assert all((frames[name][0] == by_pyav()).all() for name in ("imageio-ffmpeg", "imageio", "OpenCV", "decord"))
        for name, (frame, mean, score) in frames.items():
            difference = frame.astype(float) - picture
            psnr = 10 * np.log10(255**2 / (difference**2).mean())
            print(f"{name:15} {difference.mean():5.2f} {psnr:.1f} dB")
            assert abs(difference.mean() - mean) < 0.1 and abs(psnr - score) < 0.25
PYTHON
echo "as described"
