#!/usr/bin/env bash
# A film with transparency, as of a turntable or of a cut-out object: what six readers show where nothing is.
#
# A red disc, opaque, on transparent pixels whose hidden colour is green, as an encoder or a renderer leaves any colour
# there. VP9 in WebM, ProRes 4444 in MOV, FFV1 in MKV. The pixel in the corner:
#   OpenCV 5.0.0.93, decord 0.6.0, imageio 2.38.1, imageio-ffmpeg 0.8.1     green, as if it were there; no alpha
#   PyAV 18.1.0, `to_image()`, format="rgb24"                               green
#               format="rgba"                  ProRes, FFV1: alpha 0; VP9: alpha 255, its default decoder leaves it out
#               format="rgba", codec "libvpx-vp9" for the same packets     VP9: alpha 0
#   imageio, plugin "pyav", format="rgba"      as PyAV's default
#   imageio-ffmpeg, pixelformat "rgba"         no alpha, three channels
#   moviepy 2.2.1, has_mask=True               green, and a mask of 0
# No warning. Frames that are given to a reconstruction then have a backdrop that turns with the camera.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 av==18.1.0 opencv-python-headless==5.0.0.93 decord==0.6.0 imageio==2.38.1 \
    imageio-ffmpeg==0.8.1 moviepy==2.2.1
env/bin/python - <<'PYTHON'
import av
import cv2
import decord
import imageio.v2
import imageio.v3
import numpy as np
from moviepy import VideoFileClip

rows, columns = np.mgrid[:64, :64]
disc = np.hypot(rows - 31.5, columns - 31.5) < 20
picture = np.where(disc[..., None], [200, 40, 40, 255], [0, 255, 0, 0]).astype(np.uint8)


def write(name, codec, pixels, **options):
    with av.open(name, "w") as file:
        stream = file.add_stream(codec, rate=10, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 64, pixels
        for _ in range(8):
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, "rgba")))
        file.mux(stream.encode())


def by_libvpx(name):
    with av.open(name) as file:
        decoder = av.CodecContext.create("libvpx-vp9", "r")
        return [frame for packet in file.demux(video=0) for frame in decoder.decode(packet)][0]


def green(pixel):
    return np.allclose(pixel[:3], [0, 255, 0], atol=3)


films = {
    "film.webm": ("libvpx-vp9", "yuva420p", {"crf": "5", "b": "0"}),
    "film.mov": ("prores_ks", "yuva444p10le", {}),
    "film.mkv": ("ffv1", "yuva420p", {}),
}
for name, (codec, pixels, options) in films.items():
    write(name, codec, pixels, **options)
    with av.open(name) as file:
        frame = next(file.decode(video=0))
    corners = {
        "PyAV, to_image": frame.to_image().getpixel((0, 0)),
        "PyAV, rgb24": frame.to_ndarray(format="rgb24")[0, 0],
        "OpenCV": cv2.VideoCapture(name).read()[1][0, 0, ::-1],
        "decord": decord.VideoReader(name)[0].asnumpy()[0, 0],
        "imageio": imageio.v3.imread(name, plugin="pyav", index=0)[0, 0],
        "imageio-ffmpeg": imageio.v2.get_reader(name, "ffmpeg").get_data(0)[0, 0],
        "imageio-ffmpeg, rgba": imageio.v2.get_reader(name, "ffmpeg", pixelformat="rgba").get_data(0)[0, 0],
    }
    for reader, corner in corners.items():
        assert len(corner) == 3 and green(corner), reader
    alphas = {
        "PyAV, rgba": frame.to_ndarray(format="rgba"),
        "imageio, rgba": imageio.v3.imread(name, plugin="pyav", index=0, format="rgba"),
    }
    for reader, found in alphas.items():
        print(f"{name}, {reader}: corner {found[0, 0].tolist()}, middle {found[32, 32].tolist()}")
        assert found[0, 0, 3] == (255 if name == "film.webm" else 0) and found[32, 32, 3] == 255
    clip = VideoFileClip(name, has_mask=True)
    mask = clip.mask.get_frame(0)
    print(f"{name}, others: {[int(value) for value in corners['OpenCV']]}; moviepy's mask {mask[0, 0]}, {mask[32, 32]}")
    assert green(clip.get_frame(0)[0, 0]) and mask[0, 0] == 0 and mask[32, 32] == 1
found = by_libvpx("film.webm").to_ndarray(format="rgba")
print("film.webm, libvpx-vp9:", found[0, 0].tolist(), found[32, 32].tolist())
assert found[0, 0, 3] == 0 and found[32, 32, 3] == 255
PYTHON
echo "as described"
