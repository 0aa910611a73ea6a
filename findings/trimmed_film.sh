#!/usr/bin/env bash
# A film that was trimmed without encoding it again: three programs count frames that nobody sees.
#
# A cut that copies packets keeps them from the last key frame on, and an edit list in the MP4 says where the film begins.
# Of 48 frames, the first 18 cut off, PyAV 18.1.0 and OpenCV 5.0.0.93 decode 30. But
#   stream.frames of PyAV, CAP_PROP_FRAME_COUNT of OpenCV   48
#   decord 0.6.0                            48, the last 18 of which are the 30th once more; lines on stderr
# Frames drawn evenly from 48 are, by more than a third, no frames. Count what is decoded.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 av==18.1.0 opencv-python-headless==5.0.0.93 decord==0.6.0
env/bin/python - <<'PYTHON'
from fractions import Fraction

import av
import cv2
import decord
import numpy as np

FRAMES, CUT, RATE = 48, 18, 30
with av.open("whole.mp4", "w") as film:
    stream = film.add_stream("libx264", rate=RATE)
    stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
    for number in range(FRAMES):  # each is gray, five levels brighter than the last
        picture = av.VideoFrame.from_ndarray(np.full((64, 96, 3), 5 * number, np.uint8), format="rgb24")
        film.mux(stream.encode(picture))
    film.mux(stream.encode())
with av.open("whole.mp4") as film, av.open("trimmed.mp4", "w") as trimmed:
    source = film.streams.video[0]
    target = trimmed.add_stream_from_template(source)
    shift = round(Fraction(CUT, RATE) / source.time_base)
    for packet in film.demux(source):
        if packet.dts is not None:
            packet.stream, packet.pts, packet.dts = target, packet.pts - shift, packet.dts - shift
            trimmed.mux(packet)


def number(picture):
    return round(float(picture.mean()) / 5)


with av.open("trimmed.mp4") as film:
    stated = film.streams.video[0].frames
    decoded = [number(frame.to_ndarray(format="rgb24")) for frame in film.decode(video=0)]
print(f"PyAV: {stated} stated, {len(decoded)} decoded, {decoded[0]} to {decoded[-1]}")
assert stated == FRAMES and decoded == list(range(CUT, FRAMES))

capture = cv2.VideoCapture("trimmed.mp4")
stated, read = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0
while capture.read()[0]:
    read += 1
print(f"OpenCV: {stated} stated, {read} read")
assert (stated, read) == (FRAMES, FRAMES - CUT)

reader = decord.VideoReader("trimmed.mp4")
pictures = reader.get_batch(range(len(reader))).asnumpy()
print("decord:", [number(picture) for picture in pictures])
assert [number(picture) for picture in pictures] == decoded + decoded[-1:] * CUT
PYTHON
