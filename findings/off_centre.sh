#!/usr/bin/env bash
# A principal point off the middle, as of a cropped photograph: where four programs then put the optical axis.
#
# In a picture of 640 x 480 pixels the axis lies at (300, 200), in a matrix K with focal lengths 500 and 520.
#   trimesh 5.2.0, `Camera.K = K`   the picture becomes 600 x 400, and `camera_rays` gives 240,000 rays for 307,200: its
#                                   principal point is always the middle. No word
#   Mitsuba 3.9.1, `principal_point_offset_x`, VTK 9.7.2, `SetWindowCenter`, OpenUSD 26.11, `horizontalApertureOffset`
#                                   move the window, not the point: what is positive takes the axis to the left, for
#                                   the vertical one of Mitsuba up, of VTK and OpenUSD down. 0.1 of the width: 64 pixels
#                                   to the left of the middle. VTK counts halves of the picture, OpenUSD units of its
#                                   aperture, Mitsuba the whole
# So for K: 0.5 - cx / W and 0.5 - cy / H in Mitsuba; 1 - 2 cx / W and 2 cy / H - 1 in VTK; in OpenUSD the aperture times
# 0.5 - cx / W and cy / H - 0.5. All three then have the axis at (300, 200).
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 mitsuba==3.9.1 vtk==9.7.2 usd-core==26.11 numpy==2.4.6
env/bin/python - <<'PYTHON'
import mitsuba
import numpy as np
import trimesh
from pxr import Gf, Usd, UsdGeom
from vtkmodules.vtkRenderingCore import vtkCamera

W, H, CX, CY, FX, FY = 640, 480, 300, 200, 500, 520
camera = trimesh.scene.Camera(resolution=(W, H), focal=(FX, FY))
camera.K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
scene = trimesh.Scene(trimesh.primitives.Box(), camera=camera, camera_transform=np.eye(4))
rays = len(scene.camera_rays()[2])
print(f"trimesh: {camera.resolution}, {rays} rays")
assert list(camera.resolution) == [600, 400] and rays == 600 * 400


def pixel(x, y):
    """Of coordinates from -1 to 1, of which y goes up."""
    return np.array([(1 + x) * W / 2, (1 - y) * H / 2])


def by_vtk(x, y):
    window = vtkCamera()
    window.SetPosition(0, 0, 0)
    window.SetFocalPoint(0, 0, -1)
    window.SetWindowCenter(x, y)
    point = np.array(window.GetProjectionTransformMatrix(W / H, 0.1, 10).MultiplyPoint((0, 0, -1, 1)))
    return pixel(*(point / point[3])[:2])


def by_openusd(x, y):
    stage = Usd.Stage.CreateInMemory()
    lens = UsdGeom.Camera.Define(stage, "/lens")
    for attribute, value in (
        (lens.CreateHorizontalApertureAttr(), 32.0),
        (lens.CreateVerticalApertureAttr(), 24.0),
        (lens.CreateFocalLengthAttr(), 25.0),
        (lens.CreateHorizontalApertureOffsetAttr(), 32 * x),
        (lens.CreateVerticalApertureOffsetAttr(), 24 * y),
    ):
        attribute.Set(value)
    frustum = lens.GetCamera().frustum
    seen = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(Gf.Vec3d(0, 0, -1))
    return pixel(seen[0], seen[1])


def by_mitsuba(x, y):
    mitsuba.set_variant("scalar_rgb")
    axes = mitsuba.ScalarTransform4f(np.diag([-1.0, -1, 1, 1]))  # of OpenCV
    film = {"type": "hdrfilm", "width": W // 10, "height": H // 10, "rfilter": {"type": "box"}}
    lamp = {"type": "sphere", "center": [0, 0, 3], "radius": 0.1, "emitter": {"type": "area", "radiance": 1.0}}
    sensor = {
        "type": "perspective",
        "to_world": axes,
        "fov_axis": "x",
        "fov": float(2 * np.degrees(np.arctan(W / 2 / FX))),
        "principal_point_offset_x": x,
        "principal_point_offset_y": y,
        "film": film,
        "sampler": {"type": "independent", "sample_count": 64},
    }
    made = mitsuba.load_dict({"type": "scene", "integrator": {"type": "direct"}, "sensor": sensor, "lamp": lamp})
    light = np.array(mitsuba.render(made))[..., 0]
    rows, columns = np.mgrid[: H // 10, : W // 10]
    return 10 * np.array([((columns + 0.5) * light).sum(), ((rows + 0.5) * light).sum()]) / light.sum()


for name, where, positive, matched in (
    ("Mitsuba", by_mitsuba, (0.1, 0.1), (0.5 - CX / W, 0.5 - CY / H)),
    ("VTK", by_vtk, (0.2, 0.2), (1 - 2 * CX / W, 2 * CY / H - 1)),
    ("OpenUSD", by_openusd, (0.1, 0.1), (0.5 - CX / W, CY / H - 0.5)),
):
    shifted, found = where(*positive), where(*matched)
    print(f"{name}: {positive} puts the axis at {shifted.round(1)}, of K at {found.round(1)}")
    assert np.allclose(shifted, [W / 2 - 64, H / 2 + (-48 if name == "Mitsuba" else 48)], atol=1)
    assert np.allclose(found, [CX, CY], atol=1)
PYTHON
echo "as described"
