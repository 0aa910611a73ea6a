#!/usr/bin/env bash
# OpenUSD 26.11: between two keys a camera given as matrices shrinks, and a quaternion of norm 2 does not turn.
#
# `UsdGeom.Camera.SetFromCamera` writes a matrix for each time, and matrices are interpolated number by number. A turn
# from time 0 to 10, in degrees at times 5 and 2.5, and the size at 5, where a turn has 1:
#                   as SetFromCamera writes it       as an orient op
#   30 degrees      15, 7.4, size 0.966              15, 7.5, size 1
#   90 degrees      45, 18.4, size 0.707             45, 22.5, size 1
#   170 degrees     85, 4.9, size 0.087              85, 42.5, size 1
#   180 degrees     size 0: no inverse; 0 at 2.5     90, 45, size 1
# On an orbit of radius 5 with a key each 30 degrees a camera comes to 4.83, and what it sees is scaled.
# A turn of 30 degrees as a quaternion of norm 2, such as a network's raw output: 0 degrees by an orient op, 77 degrees
# and 2.05 times the size by PointInstancer; of norm 0.5: 122 and 7.
# No warning of any of this. Write a key for each frame, or orient and translate ops, and normalise quaternions.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet usd-core==26.11 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import math

import numpy as np
from pxr import Gf, Usd, UsdGeom

axis = Gf.Vec3d(0, 0, 1)


def quaternion(degrees, norm=1.0):
    half = math.radians(degrees) / 2
    return Gf.Quatf(norm * math.cos(half), 0, 0, norm * math.sin(half))


def turn(matrix):
    """Angle about z and size of a matrix, which holds its axes in rows."""
    matrix = np.array(matrix)[:2, :2]
    return math.degrees(math.atan2(matrix[0, 1], matrix[0, 0])), math.sqrt(abs(np.linalg.det(matrix)))


def animated(degrees):
    stage = Usd.Stage.CreateInMemory()
    camera = UsdGeom.Camera.Define(stage, "/camera")
    orient = UsdGeom.Xform.Define(stage, "/turned").AddOrientOp()
    for time, angle in ((0, 0), (10, degrees)):
        lens = Gf.Camera()
        lens.transform = Gf.Matrix4d().SetRotate(Gf.Rotation(axis, angle))
        camera.SetFromCamera(lens, time)
        orient.Set(quaternion(angle), time)
    turned = UsdGeom.Xformable(stage.GetPrimAtPath("/turned"))
    return [[turn(prim.GetLocalTransformation(time)) for time in (5, 2.5)] for prim in (camera, turned)], stage


for degrees, size, early in ((30, 0.966, 7.4), (90, 0.707, 18.4), (170, 0.087, 4.9), (180, 0, 0)):
    (matrices, orients), stage = animated(degrees)
    print(degrees, "matrices", np.round(matrices, 3).tolist(), "orient", np.round(orients, 3).tolist())
    assert abs(matrices[0][1] - size) < 1e-3 and abs(matrices[1][0] - early) < 0.1
    assert np.allclose(orients, [[degrees / 2, 1], [degrees / 4, 1]], atol=1e-3)

stage = Usd.Stage.CreateInMemory()
camera = UsdGeom.Camera.Define(stage, "/orbit")
for key in range(13):
    lens, angle = Gf.Camera(), math.radians(30 * key)
    around = Gf.Matrix4d().SetRotate(Gf.Rotation(axis, 30 * key))
    lens.transform = around * Gf.Matrix4d().SetTranslate(Gf.Vec3d(5 * math.cos(angle), 5 * math.sin(angle), 0))
    camera.SetFromCamera(lens, key)
between = camera.GetCamera(0.5).transform
print("orbit", between.ExtractTranslation().GetLength(), turn(between))
assert abs(between.ExtractTranslation().GetLength() - 4.83) < 0.01 and abs(turn(between)[1] - 0.966) < 1e-3

stage = Usd.Stage.CreateInMemory()
for norm, turned, instanced in ((1, (30, 1), (30, 1)), (2, (0, 1), (77, 2.05)), (0.5, (122, 1), (7, 0.97))):
    prim = UsdGeom.Xform.Define(stage, f"/norm{int(norm * 10)}")
    prim.AddOrientOp().Set(quaternion(30, norm))
    found = turn(prim.GetLocalTransformation())
    points = UsdGeom.PointInstancer.Define(stage, f"/points{int(norm * 10)}")
    points.CreateProtoIndicesAttr([0])
    points.CreatePositionsAttr([Gf.Vec3f(0)])
    points.CreateOrientationsfAttr([quaternion(30, norm)])
    points.CreatePrototypesRel().AddTarget(prim.GetPath())
    (instance,) = points.ComputeInstanceTransformsAtTime(0, 0, UsdGeom.PointInstancer.ExcludeProtoXform)
    print("norm", norm, "orient op", found, "instance", turn(instance))
    assert np.allclose(found, turned, atol=0.5) and abs(turn(instance)[0] - instanced[0]) < 0.5
    assert abs(turn(instance)[1] - instanced[1]) < 0.01
PYTHON
echo "as described"
