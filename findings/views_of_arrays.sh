#!/usr/bin/env bash
# Views of an array, as a channel of a picture: OpenEXR 3.5.3 and safetensors 0.8.0 write other numbers, silently.
#
# Both take an array's memory for its content. A picture of 4 x 5 pixels, pixel (row, column) = 3 (5 row + column) + 0,
# 1, 2 in red, green and blue; what comes back of its first row:
#   OpenEXR {"RGB": picture}                                right
#           {"R": picture[..., 0], "G": ..., "B": ...}      red 0 1 2 3 4 in place of 0 3 6 9 12, green 1 2 3 4 5
#           {"Z": positions[..., 2]}                        2 3 4 5 6 in place of 2 5 8 11 14
#           {"Z": depth.T}                                  0 1 2 3 in place of 0 5 10 15
#           {"RGB": channels.transpose(1, 2, 0)}            0 1 2 in place of 0 20 40: its first pixel
#   safetensors.numpy, of a table of 3 x 4, 0 to 11:
#           table.T                                         0 1 2 | 3 4 5 | ... in place of 0 4 8 | 1 5 9 | ...
#           table[:, ::2]                                   0 1 | 2 3 | 4 5 in place of 0 2 | 4 6 | 8 10
#           np.asfortranarray(table)                        0 4 8 1 | 5 9 2 6 | ... in place of 0 1 2 3 | ...
#   numpy.save of the same                                  right
# Sizes and types are right, and nothing is said; safetensors documents that arrays must be contiguous, and its torch
# half refuses others. Write `np.ascontiguousarray(array)`; OpenEXR's "RGB" takes an H x W x 3 array as it is.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet OpenEXR==3.5.3 safetensors==0.8.0 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import io

import numpy as np
import OpenEXR
from safetensors.numpy import load, load_file, save, save_file


def by_exr(channels):
    with OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}, channels) as file:
        file.write("picture.exr")
    with OpenEXR.File("picture.exr") as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def by_safetensors(array):
    save_file({"array": array}, "arrays.safetensors")
    found = load_file("arrays.safetensors")["array"]
    assert np.array_equal(load(save({"array": array}))["array"], found)
    return found


def by_numpy(array):
    file = io.BytesIO()
    np.save(file, array)
    file.seek(0)
    return np.load(file)


picture = np.arange(60, dtype=np.float32).reshape(4, 5, 3)
depth = np.arange(20, dtype=np.float32).reshape(4, 5)
planes = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
table = np.arange(12, dtype=np.float32).reshape(3, 4)

assert np.array_equal(by_exr({"RGB": picture})["RGB"], picture)
split = by_exr({name: picture[..., i] for i, name in enumerate("RGB")})["RGB"]
print("channels", split[0].tolist(), "of", picture[0].tolist())
assert split[0, :, 0].tolist() == [0, 1, 2, 3, 4] and split[0, :, 1].tolist() == [1, 2, 3, 4, 5]
copies = by_exr({name: np.ascontiguousarray(picture[..., i]) for i, name in enumerate("RGB")})["RGB"]
assert np.array_equal(copies, picture)
for title, name, array, first in (
    ("positions", "Z", picture[..., 2], [2, 3, 4, 5, 6]),
    ("depth.T", "Z", depth.T, [0, 1, 2, 3]),
    ("planes", "RGB", planes.transpose(1, 2, 0), [0, 1, 2]),
):
    found, right = by_exr({name: array})[name], np.ascontiguousarray(array)
    print(title, found[0].tolist(), "of", right[0].tolist())
    assert found.shape == array.shape and found[0].ravel()[: len(first)].tolist() == first
    assert not np.array_equal(found, array) and np.array_equal(by_exr({name: right})[name], array)
    assert np.array_equal(by_numpy(array), array)
for title, array, expected in (
    ("table.T", table.T, [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
    ("table[:, ::2]", table[:, ::2], [0, 1, 2, 3, 4, 5]),
    ("in Fortran's order", np.asfortranarray(table), [0, 4, 8, 1, 5, 9, 2, 6, 10, 3, 7, 11]),
):
    found = by_safetensors(array)
    print(title, found.tolist(), "of", array.tolist())
    assert found.shape == array.shape and found.ravel().tolist() == expected
    assert not np.array_equal(found, array) and np.array_equal(by_numpy(array), array)
    assert np.array_equal(by_safetensors(np.ascontiguousarray(array)), array)
PYTHON
echo "as described"
