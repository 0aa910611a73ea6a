#!/usr/bin/env bash
# Fisheye lenses that see behind the camera: where libraries say a pixel beyond 90 degrees looks.
#
# Lenses of action cameras and of 360-degree cameras see 100 degrees off the axis and more. By the model of Kannala and
# Brandt without terms (OPENCV_FISHEYE), a focal length of 300 pixels, the pixel 523.6 from the middle looks there. The
# plane at z = 1 has no place for it. Of its ray, as (x, 0, 1) or whole:
#   pycolmap 4.2.1, cam_from_img and cam_ray_from_img   60.2 degrees: what a pixel of 315 sees, too
#   kornia 0.9.0, undistort_points_kannala_brandt       80 degrees
#   opencv 5.0.0.93, fisheye.undistortPoints            90 degrees (x = 1.8e16)
#   poselib 2.0.5, Camera.unproject                     80 degrees on the other side: the ray's line, backwards
#   gtsam 4.3.0, Cal3Fisheye.calibrate                  raises
# The other way, a point at 100 degrees is 419 pixels to the other side for OpenCV; pycolmap says nan. No warning.
# cam_ray_from_img is described as supporting rays that face back. Mask such pixels before features are found.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6 pycolmap==4.2.1 kornia==0.9.0 opencv-python-headless==5.0.0.93 \
    poselib==2.0.5 gtsam==4.3.0
env/bin/python -W error - <<'PYTHON'
import math

import cv2
import gtsam
import numpy as np
import poselib
import pycolmap
import torch
from kornia.geometry.camera.distortion_kannala_brandt import undistort_points_kannala_brandt

FOCAL = 300.0
parameters = [FOCAL, FOCAL, 0, 0, 0, 0, 0, 0]
matrix = np.diag([FOCAL, FOCAL, 1])
by_pycolmap = pycolmap.Camera(model="OPENCV_FISHEYE", width=1600, height=1600, params=parameters)
by_poselib = poselib.Camera("OPENCV_FISHEYE", parameters, 1600, 1600)
by_gtsam = gtsam.Cal3Fisheye(FOCAL, FOCAL, 0, 0, 0, 0, 0, 0, 0)


def degrees(x, z=1.0):
    return math.degrees(math.atan2(x, z))


def seen(angle):
    """The angle that each library has for the pixel in which the lens sees this angle."""
    pixel = np.array([[FOCAL * math.radians(angle), 0.0]])
    x, _, z = by_pycolmap.cam_ray_from_img(pixel)[0]
    undistorted = undistort_points_kannala_brandt(torch.from_numpy(pixel), torch.tensor([parameters], dtype=torch.float64))
    answers = {
        "pycolmap, cam_from_img": degrees(by_pycolmap.cam_from_img(pixel)[0, 0]),
        "pycolmap, cam_ray_from_img": degrees(x, z),
        "kornia": degrees(undistorted[0, 0].item()),
        "opencv": degrees(cv2.fisheye.undistortPoints(pixel[None], matrix, np.zeros(4))[0, 0, 0]),
        "poselib": degrees(by_poselib.unproject(pixel)[0][0]),
    }
    try:
        answers["gtsam"] = degrees(by_gtsam.calibrate(pixel[0])[0])
    except RuntimeError as error:
        answers["gtsam"] = str(error)
    return answers


for angle in (80, 100):
    for name, answer in seen(angle).items():
        print(f"{angle}: {name}: {answer}")
assert all(abs(answer - 80) < 1e-4 for answer in seen(80).values())
behind = seen(100)
assert abs(behind["pycolmap, cam_from_img"] - degrees(math.radians(100))) < 1e-9
assert abs(behind["pycolmap, cam_ray_from_img"] - degrees(math.radians(100))) < 1e-9
assert "back-facing rays" in pycolmap.Camera.cam_ray_from_img.__doc__
assert abs(behind["kornia"] - 80) < 1e-4 and abs(behind["poselib"] + 80) < 1e-4
assert abs(behind["opencv"] - 90) < 1e-4 and "fails to converge" in behind["gtsam"]

point = np.array([[math.sin(math.radians(100)), 0, math.cos(math.radians(100))]])
right, mirrored = FOCAL * math.radians(100), FOCAL * math.radians(-80)
projected = cv2.fisheye.projectPoints(point[None], np.zeros(3), np.zeros(3), matrix, np.zeros(4))[0][0, 0, 0]
print(f"seen at {right:.1f}: opencv {projected:.1f}")
assert abs(projected - mirrored) < 1e-6
assert np.isnan(by_pycolmap.img_from_cam(point)).all()
PYTHON
