#!/usr/bin/env bash
# Depth and points of big-endian files (PFM, PLY), as NumPy has them: OpenCV and VTK take the bytes the other way round.
#
# A PFM with a positive scale, or a PLY of format binary_big_endian read by plyfile 1.1.5, gives arrays of type ">f4",
# which NumPy computes with as with any other. The number 1.0 (and 2.5) then is
#   opencv 5.0.0.93, resize, imwrite, add, GaussianBlur      4.6e-41 (and 1.2e-41)
#   VTK 9.7.2 `numpy_to_vtk`, pyvista 0.49.1 `PolyData`      4.6e-41: a cloud that is one point
#   PyTorch 2.13.0 from_numpy, tensor; PyAV 18.1.0           raise; torch.frombuffer 4.6e-41
#   trimesh 5.2.0, scikit-image 0.26.0, SciPy 1.17.1, Pillow 12.3.0, faiss 1.15.1, safetensors 0.8.0      right
# No warning: 0.1 is -4.3e8. `np.stack` of a PLY's columns returns the usual order, one column by itself
# does not. Take `array.astype(np.float32)` after reading.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 opencv-python-headless==5.0.0.93 vtk==9.7.2 pyvista==0.49.1 av==18.1.0 \
    trimesh==5.2.0 scikit-image==0.26.0 scipy==1.17.1 pillow==12.3.0 faiss-cpu==1.15.1 safetensors==0.8.0 \
    plyfile==1.1.5 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import warnings

import cv2
import numpy as np
import pyvista
import safetensors.numpy
import scipy.ndimage
import skimage.transform
import torch
import trimesh
from av import VideoFrame
from PIL import Image
from plyfile import PlyData, PlyElement
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import faiss

true = np.full((30, 3), 1.0, np.float32)
true[:, 1], true[:, 2] = 2.5, 0.1
rows = np.zeros(30, [(axis, "f4") for axis in "xyz"])
for axis, values in zip("xyz", true.T):
    rows[axis] = values
PlyData([PlyElement.describe(rows, "vertex")], byte_order=">").write("points.ply")
vertices = PlyData.read("points.ply")["vertex"]
assert vertices["x"].dtype == ">f4" and np.array_equal(vertices["x"], true[:, 0])
assert np.stack([vertices[axis] for axis in "xyz"], 1).dtype == "<f4"
with open("depth.pfm", "wb") as file:
    file.write(b"PF\n3 10\n1.0\n" + true.astype(">f4").tobytes())
with open("depth.pfm", "rb") as file:
    width, height = [file.readline(), file.readline()][1].split()
    scale = float(file.readline())
    given = np.fromfile(file, "<f4" if scale < 0 else ">f4").reshape(30, 3)
assert given.dtype == ">f4" and np.array_equal(given, true) and np.isclose(given.mean(), 1.2)


def by_faiss(points):
    index = faiss.IndexFlatL2(3)
    index.add(points)
    return index.reconstruct_n(0, 30)


def by_imwrite(points):
    cv2.imwrite("depth.tiff", points)
    return cv2.imread("depth.tiff", cv2.IMREAD_UNCHANGED)


swapped, right = true.view(">f4").astype(np.float32), true
for name, use, expected in (
    ("cv2.resize", lambda points: cv2.resize(points, (3, 30), interpolation=cv2.INTER_NEAREST), swapped),
    ("cv2.add", lambda points: cv2.add(points, 0.0), swapped),
    ("cv2.imwrite", by_imwrite, swapped),
    ("cv2.GaussianBlur", lambda points: cv2.GaussianBlur(points, (1, 1), 1), swapped),
    ("numpy_to_vtk", lambda points: vtk_to_numpy(numpy_to_vtk(points, deep=True)), swapped),
    ("pyvista", lambda points: np.asarray(pyvista.PolyData(points).points), swapped),
    ("torch.frombuffer", lambda points: torch.frombuffer(points, dtype=torch.float32).reshape(30, 3).numpy(), swapped),
    ("torch.from_numpy", torch.from_numpy, ValueError),
    ("torch.tensor", torch.tensor, ValueError),
    ("PyAV", lambda points: VideoFrame.from_ndarray(points, format="grayf32le"), ValueError),
    ("trimesh", lambda points: np.asarray(trimesh.PointCloud(points).vertices), right),
    ("skimage", lambda points: skimage.transform.resize(points, (30, 3), order=0, anti_aliasing=False), right),
    ("scipy", lambda points: scipy.ndimage.zoom(points, 1), right),
    ("Pillow", lambda points: np.asarray(Image.fromarray(points)), right),
    ("faiss", by_faiss, right),
    ("safetensors", lambda points: safetensors.numpy.load(safetensors.numpy.save({"p": points}))["p"], right),
):
    try:
        found = use(given.copy())
    except ValueError as error:
        print(f"{name:17} {str(error)[:80]}")
        assert expected is ValueError
    else:
        print(f"{name:17} {found[0]}")
        assert np.allclose(found, expected, rtol=1e-6, atol=0)
PYTHON
echo "as described"
