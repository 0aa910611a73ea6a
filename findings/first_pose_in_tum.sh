#!/usr/bin/env bash
# Open3D 0.20.0: a trajectory written as TUM has lost its first pose when it is read, and another with each trip.
#
# 60 cameras of 1920 x 1080, f = 1500, on a circle of radius 4 around a scene, through
# `write_pinhole_camera_trajectory` and `read_pinhole_camera_trajectory`:
#                               .json        .log               .txt (TUM)
#   poses that come back        60           60                 59; after four trips 56
#   camera i is at its place    all          all                none: it is camera i + 1, 0.42 away
#   size, f, centre             as written   640 x 480, 525, (319.5, 239.5)    the same
#   one camera                  1            1                  0, and the reader returns without an error
# The line that describes the columns does not end: the first pose stands at its end, in the comment. evo 1.38.1 and
# NumPy read 59 of the file, too. Timestamps are row numbers, so evo pairs the rest rightly; who counts rows does not.
# .log and .txt hold no lens, and the reader puts that of a PrimeSense sensor in its place. No warning.
# Write .json; or put the line's end in: text.replace("<qw>", "<qw>\n", 1). Set the intrinsics after reading.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet open3d==0.20.0 evo==1.38.1 numpy==2.2.6
env/bin/python -W error::UserWarning - <<'PYTHON'
from pathlib import Path

import numpy as np
import open3d
from evo.tools import file_interface

RADIUS = 4


def circle(number):
    cameras = []
    for angle in 2 * np.pi * np.arange(number) / number:
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        pose[:3, 3] = -RADIUS * pose[:3, 2]
        camera = open3d.camera.PinholeCameraParameters()
        camera.intrinsic = open3d.camera.PinholeCameraIntrinsic(1920, 1080, 1500, 1500, 960, 540)
        camera.extrinsic = np.linalg.inv(pose)
        cameras.append(camera)
    trajectory = open3d.camera.PinholeCameraTrajectory()
    trajectory.parameters = cameras
    return trajectory


def trip(trajectory, name):
    assert open3d.io.write_pinhole_camera_trajectory(name, trajectory)
    return open3d.io.read_pinhole_camera_trajectory(name)


def centres(trajectory):
    return np.array([np.linalg.inv(camera.extrinsic)[:3, 3] for camera in trajectory.parameters])


written = circle(60)
right = centres(written)
step = 2 * RADIUS * np.sin(np.pi / 60)
for suffix, number in (("json", 60), ("log", 60), ("txt", 59)):
    back = trip(written, f"path.{suffix}")
    found = centres(back)
    off = np.linalg.norm(found - right[: len(found)], axis=1)
    lenses = [camera.intrinsic for camera in back.parameters]
    lenses = {(lens.width, lens.height, *map(float, lens.intrinsic_matrix[[0, 0, 1], [0, 2, 2]])) for lens in lenses}
    one = len(trip(circle(1), f"one.{suffix}").parameters)
    print(f"{suffix}: {len(found)} poses, off by up to {off.max():.3f}, lens {lenses}; of one camera {one}")
    assert len(found) == number and one == number - 59
    assert lenses == ({(1920, 1080, 1500, 960, 540)} if suffix == "json" else {(640, 480, 525, 319.5, 239.5)})
    if suffix == "txt":
        assert np.allclose(off, step, rtol=1e-3) and np.abs(found - right[1:]).max() < 1e-5
    else:
        assert off.max() < 1e-6

text = Path("path.txt").read_text()
first = text.splitlines()[0]
print(first)
assert first.startswith("#") and len(first.split("<qw>")[1].split()) == 8
by_evo, by_numpy = file_interface.read_tum_trajectory_file("path.txt"), np.loadtxt("path.txt")
print(f"evo {by_evo.num_poses}, first stamp {by_evo.timestamps[0]}; NumPy {len(by_numpy)}")
assert by_evo.num_poses == len(by_numpy) == 59 and by_evo.timestamps[0] == 1

again = written
for _ in range(4):
    again = trip(again, "again.txt")
print("after four trips:", len(again.parameters))
assert len(again.parameters) == 56

Path("mended.txt").write_text(text.replace("<qw>", "<qw>\n", 1))
mended = open3d.io.read_pinhole_camera_trajectory("mended.txt")
assert np.abs(centres(mended) - right).max() < 1e-5 and len(mended.parameters) == 60
PYTHON
echo "as described"
