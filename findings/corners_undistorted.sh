#!/usr/bin/env bash
# Points of a wide lens undistorted with default settings: OpenCV and kornia leave corners 26 pixels off, silently.
#
# A picture of 1920 x 1080 pixels, focal length 900, 94 degrees wide, as of an action camera: k1 -0.3, k2 0.1, whose
# polynomial increases everywhere, so that each pixel has one ray. How far from its place a pixel is put, in undistorted
# pixels, and how far from itself it comes back by the lens:
#                                            the corner    the middle of the right side    480 from the middle
#   pycolmap 4.2.1, cam_from_img             0, 0          0, 0                            0, 0
#   opencv 5.0.0.93, undistortPoints and undistortImagePoints, and kornia 0.9.0, undistort_points
#       as they come, five steps             26, 40        0.03, 0.03                      0.01, 0.01
#       20 steps                             0.4, 0.5      0, 0                            0, 0
#       100 steps                            0, 0          0, 0                            0, 0
#   gtsam 4.3.0, Cal3DS2.calibrate           raises        0, 0                            0, 0
# No warning. Matches, lines and rays in the corners are then wrong, while the undistorted picture is right, for its
# pixels are looked up the other way. Give `criteria` of 100 steps and 1e-9, or num_iters=100.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 kornia==0.9.0 opencv-python-headless==5.0.0.93 pycolmap==4.2.1 gtsam==4.3.0 \
    numpy==2.4.6
env/bin/python - <<'PYTHON'
import cv2
import gtsam
import kornia
import numpy as np
import pycolmap
import torch

focal, middle, lens = 900.0, np.array([960.0, 540.0]), np.array([-0.3, 0.1, 0, 0])
matrix = np.array([[focal, 0, 960], [0, focal, 540], [0, 0, 1]])
pixels = np.array([[1919.5, 1079.5], [1919.5, 540], [1440, 540]])
radii = np.linspace(0, 3, 1000)
assert (np.diff(radii * (1 + lens[0] * radii**2 + lens[1] * radii**4)) > 0).all()
camera = pycolmap.Camera(model="OPENCV", width=1920, height=1080, params=[focal, focal, *middle, *lens])
true = camera.cam_from_img(pixels)


def project(points):
    points = np.column_stack([points, np.ones(len(points))])
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, lens)[0][:, 0]


def by_kornia(**options):
    arguments = (torch.tensor(value)[None] for value in (pixels, matrix, lens))
    return (kornia.geometry.calibration.undistort_points(*arguments, **options)[0].numpy() - middle) / focal


def by_opencv(count=None):
    if count is None:
        return cv2.undistortPoints(pixels[:, None], matrix, lens)[:, 0]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, count, 1e-9)
    return cv2.undistortPoints(pixels[:, None], matrix, lens, criteria=criteria)[:, 0]


found = {
    "pycolmap": true,
    "undistortPoints": by_opencv(),
    "undistortImagePoints": (cv2.undistortImagePoints(pixels[:, None], matrix, lens)[:, 0] - middle) / focal,
    "kornia": by_kornia(),
    "kornia, 20": by_kornia(num_iters=20),
    "kornia, 100": by_kornia(num_iters=100),
    "opencv, 20": by_opencv(20),
    "opencv, 100": by_opencv(100),
}
expected = {"20": ([0.4, 0, 0], [0.5, 0, 0]), "100": ([0, 0, 0], [0, 0, 0]), "pycolmap": ([0, 0, 0], [0, 0, 0])}
for name, points in found.items():
    off = np.linalg.norm(points - true, axis=1) * focal
    back = np.linalg.norm(project(points) - pixels, axis=1)
    print(f"{name:22} {off.round(3)} {back.round(3)}")
    places = expected.get(name.split(", ")[-1], ([26.5, 0.03, 0.01], [39.7, 0.03, 0.01]))
    assert np.allclose([off, back], places, rtol=0.02, atol=[0.1, 0.005, 0.005]), name
lens_of_gtsam = gtsam.Cal3DS2(focal, focal, 0, *middle, *lens)
try:
    lens_of_gtsam.calibrate(pixels[0])
except RuntimeError as error:
    print("gtsam:", error)
else:
    raise AssertionError
assert np.allclose([lens_of_gtsam.calibrate(pixel) for pixel in pixels[1:]], true[1:], atol=1e-6)
PYTHON
echo "as described"
