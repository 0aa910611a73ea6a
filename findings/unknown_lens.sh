#!/usr/bin/env bash
# PoseLib 2.0.5: a lens of COLMAP that it does not know is taken for none, and every photograph's pose is the identity.
#
# 200 points, exact, 4 units before a camera, in pixels of pycolmap 4.2.1's cameras, whose dictionaries (model, width,
# height, params) PoseLib takes. `estimate_absolute_pose`; `estimate_relative_pose` of two views agrees:
#   SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, OPENCV_FISHEYE, FULL_OPENCV   exact, 200 inliers
#   FOV, SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE, THIN_PRISM_FISHEYE, RAD_TAN_THIN_PRISM_FISHEYE, SIMPLE_DIVISION,
#   DIVISION, EUCM, and "opencv" in small letters: the identity, 0 inliers
# `poselib.Camera(...)` of these has the model NULL. No exception, no warning: photographs go missing, or all stand in
# one place. Look at `Camera(...).model_name()`, and undistort first.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet poselib==2.0.5 pycolmap==4.2.1 scipy==1.17.1 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import poselib
import pycolmap
from scipy.spatial.transform import Rotation

fisheye = [500, 490, 400, 300, 0.02, -0.01, 0.001, 0.0005]
known = {
    "SIMPLE_PINHOLE": [800, 400, 300],
    "PINHOLE": [800, 790, 400, 300],
    "SIMPLE_RADIAL": [800, 400, 300, -0.1],
    "RADIAL": [800, 400, 300, -0.1, 0.02],
    "OPENCV": [800, 790, 400, 300, -0.1, 0.02, 0.001, -0.002],
    "OPENCV_FISHEYE": fisheye,
    "FULL_OPENCV": [800, 790, 400, 300, -0.1, 0.02, 0.001, -0.002, 0.01, 0.02, 0.003, 0.001],
}
unknown = {
    "FOV": [500, 490, 400, 300, 0.9],
    "SIMPLE_RADIAL_FISHEYE": [500, 400, 300, 0.02],
    "RADIAL_FISHEYE": [500, 400, 300, 0.02, -0.01],
    "THIN_PRISM_FISHEYE": [*fisheye, 0.01, 0.002, 0.003, 0.004],
    "RAD_TAN_THIN_PRISM_FISHEYE": [*fisheye, 0, 0, 0.003, 0.004, 0.001, 0.001, 0.001, 0.001],
    "SIMPLE_DIVISION": [800, 400, 300, -0.1],
    "DIVISION": [800, 790, 400, 300, -0.1],
    "EUCM": [500, 490, 400, 300, 0.6, 1.1],
    "opencv": known["OPENCV"],
}
random = np.random.default_rng(0)
world = random.uniform(-1, 1, (200, 3)) + [0, 0, 4]
rotation, shift = Rotation.from_rotvec([0.1, 0.3, -0.2]).as_matrix(), np.array([0.2, -0.1, 0.3])
seen = world @ rotation.T + shift
for name, params in (known | unknown).items():
    lens = pycolmap.Camera(model=name.upper(), width=800, height=600, params=params)
    here, there = (np.array([lens.img_from_cam(point) for point in points]) for points in (world, seen))
    camera = {"model": name, "width": 800, "height": 600, "params": params}
    pose, told = poselib.estimate_absolute_pose(there, world, camera, {}, {})
    between, also = poselib.estimate_relative_pose(here, there, camera, camera, {}, {})
    model = poselib.Camera(name, params, 800, 600).model_name()
    print(f"{name:27} is {model:15} inliers {told['num_inliers']}, {also['num_inliers']}; shift {np.round(pose.t, 3)}")
    if name in known:
        assert model == name and told["num_inliers"] == also["num_inliers"] == 200
        assert np.allclose(pose.R, rotation, atol=1e-5) and np.allclose(pose.t, shift, atol=1e-5)
        assert np.allclose(between.R, rotation, atol=1e-5)
    else:
        assert model == "NULL" and told["num_inliers"] == also["num_inliers"] == 0
        assert np.array_equal(pose.R, np.eye(3)) and np.array_equal(pose.t, np.zeros(3))
        assert np.array_equal(between.R, np.eye(3))
PYTHON
echo "as described"
