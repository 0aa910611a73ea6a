#!/usr/bin/env bash
# A film of variable rate, as of phones and screen recordings: which frame four programs give for a number, or a time.
#
# 48 frames, 24 of them 1/30 s apart and 24 of them 2/30 s, H.264 with two B-frames in MP4. PyAV 18.1.0 decodes 48 at
# their times, decord 0.6.0 gives each by its number. But
#   OpenCV 5.0.0.93, CAP_PROP_POS_FRAMES    another frame for 20 of 48 numbers, up to 7 away; none for 6 of the last 7
#                   CAP_PROP_POS_MSEC       another frame for 41 of 48 times, up to 7 away: seconds become numbers by
#                                           the mean rate, 20.87. A time that was read with a frame does not find it
#   imageio 2.38.1, plugin "pyav", index=   frame 32 for 38, 39 for 47: a file opened anew for each has ten wrong ones;
#                                           opened once and read in order it has none
#   imageio-ffmpeg 0.8.1                    `count_frames` 48, 72 come, repeated to 30/s; `get_data(36)` is frame 30
#                                           when read in order, 38 after the last
#   moviepy 2.2.1                           48, at 20.87/s of those 72: frame 35 is the last
# No warning. With all frames 1/30 s apart all are right. Decode in order, and count what comes.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 av==18.1.0 opencv-python-headless==5.0.0.93 decord==0.6.0 imageio==2.38.1 \
    imageio-ffmpeg==0.8.1 moviepy==2.2.1
env/bin/python - <<'PYTHON'
from fractions import Fraction

import av
import cv2
import decord
import imageio.v2
import imageio.v3
import numpy as np
from moviepy import VideoFileClip


def write(name, ticks):
    with av.open(name, "w") as file:
        stream = file.add_stream("libx264", rate=30)
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        stream.options = {"g": "12", "bf": "2", "crf": "10"}
        stream.codec_context.time_base = Fraction(1, 30)
        for number, tick in enumerate(ticks):
            picture = np.zeros((64, 64, 3), np.uint8)  # a bar for each bit of its number
            for bit in range(6):
                picture[:, 10 * bit : 10 * bit + 10] = 255 * (number >> bit & 1)
            frame = av.VideoFrame.from_ndarray(picture, "rgb24")
            frame.pts, frame.time_base = int(tick), Fraction(1, 30)
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def number(picture):
    return sum(int(np.asarray(picture)[:, 10 * bit + 3 : 10 * bit + 7].mean() > 127) << bit for bit in range(6))


def by_opencv(name, key, places):
    reader, numbers = cv2.VideoCapture(name), []
    for place in places:
        reader.set(key, place)
        there, picture = reader.read()
        numbers.append(number(picture) if there else -1)
    return np.array(numbers)


def found(name, ticks):
    with av.open(name) as file:
        frames = [(number(frame.to_ndarray(format="rgb24")), frame.time) for frame in file.decode(video=0)]
    assert [which for which, _ in frames] == list(range(48)) and np.allclose([time for _, time in frames], ticks / 30)
    reader = decord.VideoReader(name)
    assert [number(reader[i].asnumpy()) for i in range(len(reader))] == list(range(48))
    with imageio.v3.imopen(name, "r", plugin="pyav") as file:
        assert [number(file.read(index=i)) for i in range(48)] == list(range(48))
    by_ffmpeg = imageio.v2.get_reader(name, "ffmpeg")
    clip = VideoFileClip(name)
    return {
        "POS_FRAMES": by_opencv(name, cv2.CAP_PROP_POS_FRAMES, range(48)),
        "POS_MSEC": by_opencv(name, cv2.CAP_PROP_POS_MSEC, 1000 * ticks / 30 + 0.1),
        "imageio, PyAV": np.array([number(imageio.v3.imread(name, plugin="pyav", index=i)) for i in range(48)]),
        "imageio-ffmpeg": np.array([number(picture) for picture in by_ffmpeg]),
        "counted": by_ffmpeg.count_frames(),
        "get_data(36)": number(imageio.v2.get_reader(name, "ffmpeg").get_data(36)),
        "after the last": number(by_ffmpeg.get_data(36)),
        "moviepy": np.array([number(picture) for picture in clip.iter_frames()]),
    }


same = np.arange(48)
write("even.mp4", same)
for name, numbers in found("even.mp4", same).items():
    assert np.array_equal(numbers, {"counted": 48, "get_data(36)": 36, "after the last": 36}.get(name, same)), name
ticks = np.concatenate([np.arange(24), 24 + 2 * np.arange(24)])
write("varied.mp4", ticks)
answers = found("varied.mp4", ticks)
for name, numbers in answers.items():
    print(f"{name}: {numbers if isinstance(numbers, int) else numbers.tolist()}")
for name, wrong, away in (("POS_FRAMES", 26, 7), ("POS_MSEC", 46, 7), ("imageio, PyAV", 10, 8)):
    numbers = answers[name]
    there = numbers >= 0
    print(name, (numbers != same).sum(), abs(numbers - same)[there].max(), "not there:", (~there).sum())
    assert (numbers != same).sum() == wrong and abs(numbers - same)[there].max() == away
assert answers["imageio, PyAV"][38] == 32 and answers["imageio, PyAV"][47] == 39
assert answers["counted"] == 48 and len(answers["imageio-ffmpeg"]) == 72
assert answers["get_data(36)"] == 30 and answers["after the last"] == 38
assert len(answers["moviepy"]) == 48 and answers["moviepy"][-1] == 35
PYTHON
echo "as described"
