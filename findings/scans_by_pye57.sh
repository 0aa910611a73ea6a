#!/usr/bin/env bash
# pye57 0.4.19, scans as E57: places are written in single precision, colours that are not bytes become black or noise.
#
# 1000 points with colours through `write_scan_raw` and `read_scan`, coordinates in double precision:
#   points of a room, 0 to 10                             an error of up to 0.0000005
#   the same on a map, at (500000, 5400000)               0.016 east and 0.25 north: steps of 0.03 and 0.5
#   the same, translation=(500000, 5400000, 0) beside     0.0000005
#   colours as bytes                                      equal
#   as uint16 (0 to 65535)                                their low byte: 300 -> 44, 40000 -> 64
#   as floats of 0 to 1                                   0, and 1 for what is exactly 1: black
#   rows with cartesianInvalidState=1                     gone; labels kept beside the file belong to others
# The file's fields say "single" and "0 to 255" whatever the arrays are, though E57 has double precision and colours
# of 16 bits. No warning. Subtract an offset and hand it over as `translation`, round colours to bytes first.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pye57==0.4.19 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
from pathlib import Path

import numpy as np
import pye57

AXES = [f"cartesian{axis}" for axis in "XYZ"]
COLOURS = [f"color{name}" for name in ("Red", "Green", "Blue")]
random = np.random.default_rng(0)
room = random.uniform(0, 10, (1000, 3))
MAP = np.array([500_000.0, 5_400_000.0, 0.0])


def trip(points, colours=None, invalid=None, **pose):
    Path("scan.e57").unlink(missing_ok=True)
    arrays = dict(zip(AXES, points.T))
    if colours is not None:
        arrays |= dict(zip(COLOURS, colours.T))
    if invalid is not None:
        arrays["cartesianInvalidState"] = invalid
    scan = pye57.E57("scan.e57", mode="w")
    scan.write_scan_raw(arrays, **pose)
    scan.close()
    read = pye57.E57("scan.e57").read_scan(0, colors=colours is not None, ignore_missing_fields=True)
    found = np.stack([read[name] for name in AXES], 1)
    assert found.dtype == np.float64
    return found, None if colours is None else np.stack([read[name] for name in COLOURS], 1)


for name, points, pose, expected in (
    ("room", room, {}, (0, 1e-6)),
    ("map", room + MAP, {}, (0.2, 0.2500001)),
    ("map, translation", room, {"rotation": np.array([1.0, 0, 0, 0]), "translation": MAP}, (0, 1e-6)),
):
    found, _ = trip(points, **pose)
    truth = room if name == "room" else room + MAP
    error = np.abs(found - truth).max(0)
    steps = [np.diff(np.unique(column)).min() for column in found[:, :2].T]
    print(f"{name:18} error {error[0]:.2g}, {error[1]:.2g}, {error[2]:.2g}; least steps {steps[0]:.2g}, {steps[1]:.2g}")
    assert expected[0] <= error.max() < expected[1]
    if name == "map":
        assert 0.014 < error[0] <= 0.01563 and steps == [0.03125, 0.5]

levels = random.integers(0, 256, (1000, 3)).astype(np.uint8)
assert np.array_equal(trip(room, levels)[1], levels)
wide = random.integers(0, 65536, (1000, 3)).astype(np.uint16)
wide[0] = 300, 40000, 65535
found = trip(room, wide)[1]
print("uint16", wide[0], "->", found[0])
assert np.array_equal(found, wide & 255) and list(found[0]) == [44, 64, 255]
unit = random.uniform(0, 1, (1000, 3))
unit[0] = 0.5, 0.999, 1
found = trip(room, unit)[1]
print("floats", unit[0], "->", found[0], "and brightest of the others", found[1:].max())
assert list(found[0]) == [0, 0, 1] and found[1:].max() == 0

invalid = (np.arange(1000) % 4 == 0).astype(np.int8)
found, _ = trip(room, invalid=invalid)
print("with 250 invalid:", len(found))
assert len(found) == 750 and np.abs(found - room[invalid == 0]).max() < 1e-6
PYTHON
echo "as described"
