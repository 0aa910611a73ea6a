#!/usr/bin/env bash
# laspy 2.7.0: a scene of two units becomes a grid of 0.01; the header's scale holds for `las.x`, and not for `las.xyz`.
#
# LAS holds whole numbers times a scale, for which `laspy.create()` takes 0.01, a centimetre of a survey. Points of a
# reconstruction have no metres. 1000 of them in [-1, 1]^3, written and read, largest error of a coordinate:
#   las.xyz = points                                              0.005, at most 201 values along an axis
#   las.header.scales = [1e-5] * 3, then las.xyz = points         0.005, and the file says 1e-5
#                                   then las.x, las.y, las.z      5e-6
#   las.x, then las.header.x_scale = 1e-5, then las.y, las.z      0.999: x is divided by 1000
#   las.xyz = points, then las.change_scaling([1e-5] * 3)         0.005
#   laspy.LasData(header) of a header with scales                 5e-6 in both ways
# Colours have 16 bits: floats of 0 to 1 are 0, bytes stay as they are, 1/257 of their brightness, 70000 wraps to 4464.
# No warning of any of these. Give the header to LasData, with a scale of a millionth of the scene.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet laspy==2.7.0 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import laspy
import numpy as np

points = np.random.default_rng(0).uniform(-1, 1, (1000, 3))


def plain():
    las = laspy.create(point_format=2)
    las.xyz = points
    return las


def header_before():
    las = laspy.create(point_format=2)
    las.header.scales = [1e-5] * 3
    las.xyz = points
    return las


def change_after():
    las = plain()
    las.change_scaling(scales=[1e-5] * 3)
    return las


def header_between():
    las = laspy.create(point_format=2)
    las.x = points[:, 0]
    las.header.x_scale = 1e-5
    las.y, las.z = points[:, 1], points[:, 2]
    return las


def by_axis():
    las = laspy.create(point_format=2)
    las.header.scales = [1e-5] * 3
    las.x, las.y, las.z = points.T
    return las


def header_first():
    header = laspy.LasHeader(point_format=2)
    header.scales = [1e-5] * 3
    las = laspy.LasData(header)
    las.xyz = points
    return las


def header_first_by_axis():
    las = header_first()
    las.x, las.y, las.z = points.T
    return las


expected = {plain: 0.005, header_before: 0.005, change_after: 0.005, header_between: 0.999}
expected |= {by_axis: 5e-6, header_first: 5e-6, header_first_by_axis: 5e-6}
for make, error in expected.items():
    make().write("scene.las")
    read = laspy.read("scene.las")
    found = np.abs(read.xyz - points).max()
    print(f"{make.__name__:14} error {found:.2g}, scales {read.header.scales}")
    assert abs(found - error) < 0.01 * error
    assert make is plain or np.isclose(read.header.scales[0], 1e-5)
las = plain()
assert max(len(np.unique(axis)) for axis in np.asarray(las.xyz).T) <= 201
las.red, las.green = np.full(1000, 0.5), np.full(1000, 255, np.uint8)
las.blue = np.full(1000, 70000)
las.write("colours.las")
read = laspy.read("colours.las")
print("colours", read.red[0], read.green[0], read.blue[0])
assert set(read.red) == {0} and set(read.green) == {255} and set(read.blue) == {4464}
PYTHON
echo "as described"
