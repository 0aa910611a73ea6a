#!/usr/bin/env bash
# Colours of Gaussians that are brighter than 1, as points in eight libraries: where white becomes black, silently.
#
# `0.5 + 0.2821 f_dc` lies outside of [0, 1] wherever harmonics make up for it, as in highlights. The colours
# (1.2, -0.1, 0.5) and (2.5, -1, 0.75), as floats, in bytes:
#   rerun-sdk 0.41.0, `Points3D(colors=)`                  50, 230, 128 and 126, 1, 191: they wrap. The right ones are
#                                                          255, 0, 128 and 255, 0, 191
#   VTK 9.7.2 `DirectScalars` and pyvista 0.49.1 `rgb=True` 50, 231, 128 and 126, 2, 191
#   pymeshlab 2025.7.post1, `v_color_matrix`               50, 231, 127 and 125, 1, 191
#   vedo 2026.6.3, `pointcolors`, of 0 to 255              50, 231, 127 and 125, 1, 191; of 0 to 1 1, 0, 0 and 2, 255, 0
#   trimesh 5.2.0 255, 0, 128 and 255, 0, 191;  viser 1.1.1 255, 0, 127 and 255, 0, 191;  matplotlib 3.11.2 raises
# Floats of 0 to 255 instead: rerun has 1 for 255. and 236 for 20., trimesh 255 for both. No warning. Clip first.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numpy==2.4.6 rerun-sdk==0.41.0 vtk==9.7.2 pyvista==0.49.1 pymeshlab==2025.7.post1 \
    vedo==2026.6.3 trimesh==5.2.0 viser==1.1.1 matplotlib==3.11.2
env/bin/python - 2> log.txt <<'PYTHON'
import warnings

import matplotlib

matplotlib.use("Agg")
import numpy as np
import pymeshlab
import pyvista
import rerun
import trimesh
import vedo
import vtk
from matplotlib import pyplot
from viser._scene_api import colors_to_uint8
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

bright = np.array([[1.2, -0.1, 0.5], [2.5, -1.0, 0.75]])
large = np.array([[255.0, 128.0, 0.0], [20.0, 30.0, 40.0]])
places = np.eye(2, 3)


def by_rerun(colors):
    packed = rerun.Points3D(places, colors=colors).colors.as_arrow_array().to_pylist()
    return [[number >> shift & 255 for shift in (24, 16, 8)] for number in packed]


def by_vtk(colors):
    mapped = vtk.vtkScalarsToColors()
    mapped.SetVectorModeToRGBColors()
    return vtk_to_numpy(mapped.MapScalars(numpy_to_vtk(colors, deep=1), vtk.VTK_COLOR_MODE_DIRECT_SCALARS, -1))[:, :3]


def by_pyvista(colors):
    cloud = pyvista.PolyData(places)
    cloud["colors"] = colors
    plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
    plotter.set_background("white")
    plotter.add_mesh(cloud, scalars="colors", rgb=True, point_size=20, lighting=False)
    plotter.view_xy()
    seen, counts = np.unique(plotter.screenshot(return_img=True).reshape(-1, 3), axis=0, return_counts=True)
    return sorted(seen[np.argsort(-counts)][1:3].tolist())  # white is the most frequent


def by_pymeshlab(colors):
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(places, v_color_matrix=np.column_stack([colors, np.ones(2)])))
    return np.rint(255 * meshes.current_mesh().vertex_color_matrix()[:, :3])


def by_vedo(colors):
    cloud = vedo.Points(places)
    cloud.pointcolors = colors
    return cloud.pointcolors[:, :3]


with warnings.catch_warnings():
    warnings.simplefilter("error", UserWarning)
    warnings.simplefilter("error", RuntimeWarning)
    for name, found, expected in (
        ("rerun", by_rerun(bright), [[50, 230, 128], [126, 1, 191]]),
        ("rerun, single precision", by_rerun(bright.astype(np.float32)), [[50, 230, 128], [126, 1, 191]]),
        ("rerun, of 0 to 255", by_rerun(large), [[1, 128, 0], [236, 226, 216]]),
        ("VTK", by_vtk(bright), [[50, 231, 128], [126, 2, 191]]),
        ("pyvista, drawn", by_pyvista(bright), [[50, 231, 128], [126, 2, 191]]),
        ("pymeshlab", by_pymeshlab(bright), [[50, 231, 127], [125, 1, 191]]),
        ("vedo, of 0 to 255", by_vedo(255 * bright), [[50, 231, 127], [125, 1, 191]]),
        ("vedo, of 0 to 1", by_vedo(bright), [[1, 0, 0], [2, 255, 0]]),
        ("trimesh", trimesh.PointCloud(places, colors=bright).colors[:, :3], [[255, 0, 128], [255, 0, 191]]),
        ("trimesh, of 0 to 255", trimesh.PointCloud(places, colors=large).colors[:, :3], [[255, 255, 0], [255] * 3]),
        ("viser", colors_to_uint8(bright), [[255, 0, 127], [255, 0, 191]]),
    ):
        print(f"{name}: {np.asarray(found).astype(int).tolist()}")
        assert np.array_equal(found, expected), name
    try:
        pyplot.gca().scatter(*places[:, :2].T, c=bright)
    except ValueError as error:
        print("matplotlib:", error)
    else:
        raise AssertionError("matplotlib")
PYTHON
echo "as described"
