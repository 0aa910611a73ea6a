#!/usr/bin/env bash
# rosbags-image 0.10.4: images of ROS bags whose rows are padded come out sheared, colours and depth, silently.
#
# A picture of 90 x 60 as a sensor_msgs/Image; its `step`, the bytes of a row, is rounded up to a multiple of 64, as
# drivers and GPUs do it, and the padding is 0. `message_to_cvimage(message)`, beside the picture:
#                                        step = what a row needs    step rounded up
#   rgb8      (270 -> 320 bytes)         equal                      98 % of the pixels wrong, by up to 255
#   mono8     (90 -> 128)                equal                      98 %
#   16UC1     depth in millimetres (180 -> 192)
#                                        equal                      98 %, 6 % of them depth 0
#   32FC1     depth in metres (360 -> 384)
#                                        equal                      98 %, 6 % of them depth 0
# Shape and type are right, the first row as well; each row further is shifted by the padding of those before it, and
# the last rows are never read. That bridges to OpenCV forgot the step is known of others; this one says nothing.
# Rows in order: np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)[:, :needed], in a new
# message whose step is `needed`. Compare message.step with width * channels * bytes of the first message of a topic.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet rosbags-image==0.10.4 rosbags==0.11.9 numpy==2.4.6 opencv-python-headless==5.0.0.93
env/bin/python -W error - <<'PYTHON'
import dataclasses
from pathlib import Path

import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
Image, Header, Time = (store.types[name] for name in (
    "sensor_msgs/msg/Image", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
random = np.random.default_rng(0)
HEIGHT, WIDTH = 60, 90


def message(picture, encoding, multiple):
    rows = np.ascontiguousarray(picture).reshape(HEIGHT, -1).view(np.uint8)
    padded = np.pad(rows, ((0, 0), (0, -rows.shape[1] % multiple)))
    header = Header(stamp=Time(sec=0, nanosec=0), frame_id="camera")
    return Image(header=header, height=HEIGHT, width=WIDTH, encoding=encoding, is_bigendian=0,
                 step=padded.shape[1], data=padded.ravel())


def bagged(sent, name):
    """The message as it comes out of a bag."""
    with Writer(Path(name), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/image", Image.__msgtype__, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(sent, Image.__msgtype__))
    with Reader(Path(name)) as reader:
        (connection, _, raw), = reader.messages()
        return store.deserialize_cdr(raw, connection.msgtype)


PICTURES = {
    "rgb8": random.integers(1, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8),
    "mono8": random.integers(1, 256, (HEIGHT, WIDTH)).astype(np.uint8),
    "16UC1": random.integers(300, 5000, (HEIGHT, WIDTH)).astype(np.uint16),
    "32FC1": random.uniform(0.3, 5, (HEIGHT, WIDTH)).astype(np.float32),
}
for encoding, picture in PICTURES.items():
    plain = message_to_cvimage(bagged(message(picture, encoding, 1), f"{encoding}_plain"))
    assert np.array_equal(plain, picture), encoding
    received = bagged(message(picture, encoding, 64), f"{encoding}_padded")
    found = message_to_cvimage(received)
    wrong = (found != picture).reshape(HEIGHT, WIDTH, -1).any(-1)
    zero = (found == 0).reshape(HEIGHT, WIDTH, -1).all(-1)
    print(f"{encoding}: {plain.dtype}, step {received.step} for {picture.nbytes // HEIGHT}; padded, {wrong.mean():.3f} "
          f"of the pixels wrong, by up to {np.abs(found.astype(float) - picture).max():.1f}; {zero.mean():.3f} are 0")
    assert found.shape == picture.shape and found.dtype == picture.dtype
    assert 0.97 < wrong.mean() < 0.99 and not wrong[0].any()
    if encoding in ("16UC1", "32FC1"):
        assert 0.05 < zero.mean() < 0.07
    needed = picture.nbytes // HEIGHT
    rows = np.frombuffer(received.data, np.uint8).reshape(received.height, received.step)[:, :needed]
    mended = dataclasses.replace(received, step=needed, data=rows.ravel())
    assert np.array_equal(message_to_cvimage(mended), picture), encoding
PYTHON
echo "as described"
