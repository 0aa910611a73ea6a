#!/usr/bin/env bash
# Cameras on a straight line, as of a slider or a car: how libraries align their positions with another frame's.
#
# The rotation about the line is open. Open3D 0.20.0, roma 1.8.0, gtsam 4.3.0, scikit-image 0.26.0 and trimesh 5.2.0
# return a similarity without a word, with a residual of zero: the frame is turned about the line by an arbitrary angle,
# 41 to 160 degrees here, and every camera looks elsewhere. evo 1.38.1 raises, pycolmap 4.2.1 returns None.
# Mirrored positions, as of a frame with another handedness: trimesh returns a reflection by default, residual zero,
# determinant -1; the others a rotation that does not fit.
# Seen: 12 positions, one similarity with rotation 20, -30, 70 degrees (xyz) and scale 1.7, no noise.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 open3d==0.20.0 roma==1.8.0 gtsam==4.3.0 scikit-image==0.26.0 trimesh==5.2.0 \
    evo==1.38.1 pycolmap==4.2.1 scipy
env/bin/python - <<'PYTHON'
import math

import gtsam
import numpy as np
import open3d as o3d
import pycolmap
import roma
import torch
import trimesh
from evo.core import geometry
from scipy.spatial.transform import Rotation
from skimage.transform import SimilarityTransform

ROTATION = Rotation.from_euler("xyz", [20, -30, 70], degrees=True).as_matrix()
SCALE, SHIFT = 1.7, np.array([0.3, -1, 2])


def split(matrix):
    linear = np.asarray(matrix)[:3, :3]
    scale = np.cbrt(abs(np.linalg.det(linear)))
    return linear / scale, scale, np.asarray(matrix)[:3, 3]


def by_open3d(source, target):
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
    pairs = o3d.utility.Vector2iVector(np.stack([np.arange(len(source))] * 2, 1))
    estimate = o3d.pipelines.registration.TransformationEstimationPointToPoint(True)
    return split(estimate.compute_transformation(*clouds, pairs))


def by_roma(source, target):
    rotation, shift, scale = roma.rigid_points_registration(
        torch.tensor(source), torch.tensor(target), compute_scaling=True
    )
    return rotation.numpy(), float(scale), shift.numpy()


def by_gtsam(source, target):
    found = gtsam.Similarity3.Align(list(zip(target, source, strict=True)))
    return found.rotation().matrix(), found.scale(), found.scale() * np.asarray(found.translation())


ALIGN = {
    "open3d": by_open3d,
    "roma": by_roma,
    "gtsam": by_gtsam,
    "scikit-image": lambda source, target: split(SimilarityTransform.from_estimate(source, target).params),
    "trimesh": lambda source, target: split(trimesh.registration.procrustes(source, target)[0]),
}

line = np.zeros((12, 3))
line[:, 0] = np.linspace(0, 2, 12)
mirrored = np.random.default_rng(0).normal(size=(12, 3))
for name, align in ALIGN.items():
    for what, source, image in (("line", line, line), ("mirrored", mirrored, mirrored * [1, 1, -1])):
        target = SCALE * image @ ROTATION.T + SHIFT
        rotation, scale, shift = align(source, target)
        residual = np.abs(scale * source @ rotation.T + shift - target).max()
        angle = math.degrees(math.acos(np.clip((np.trace(rotation.T @ ROTATION) - 1) / 2, -1, 1)))
        handed = np.linalg.det(rotation)
        print(f"{name:13} {what:9} residual {residual:.1e}, determinant {handed:+.0f}, off by {angle:.0f} degrees")
        if what == "line":
            assert residual < 1e-12 and handed > 0.999 and angle > 30
        else:
            assert (residual < 1e-12 and handed < -0.999) if name == "trimesh" else (residual > 1 and handed > 0.999)
target = SCALE * line @ ROTATION.T + SHIFT
assert pycolmap.estimate_sim3d(line, target) is None
try:
    geometry.umeyama_alignment(line.T, target.T, True)
except geometry.GeometryException as error:
    print("evo:", error)
else:
    raise AssertionError("evo aligned a line")
PYTHON
echo "as described"
