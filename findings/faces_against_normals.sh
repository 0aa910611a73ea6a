#!/usr/bin/env bash
# The surface of a field by four packages: whose faces look inwards; and scikit-image 0.26.0's, against its own normals.
#
# A ball as distances (negative inside), as of an SDF, and as densities (positive inside), as of a radiance field; 33 x
# 33 x 33 numbers, level 0. Where faces look, by the sign of the volume that they enclose, 0.52 of true 0.52:
#                                                            distances      densities
#   scikit-image, marching_cubes, faces                      outwards       inwards
#                                 its normals                inwards        outwards
#       the same with gradient_direction="ascent", faces     inwards        outwards
#                                 its normals                inwards        outwards
#   libigl 2.6.3, marching_cubes                             outwards       inwards
#   PyMCubes 0.1.6, marching_cubes                           inwards        outwards
#   pyvista 0.49.1, contour, each of its three methods       inwards        outwards
# scikit-image documents its default, "descent", for objects that are greater than what is around them, by the left-hand
# rule; glTF, renderers and the volume of a mesh go by the right-hand one, and so do its own normals. No warning. A mesh
# that looks inwards has a negative volume, is not seen where backs are left out, is lit from behind by its faces and
# from before by its normals, and has its inside outside in tests of containment. Look at the sign of the volume once,
# and turn faces over (`faces[:, ::-1]`). That faces and normals disagree was asked of trimesh, which uses scikit-image.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet scikit-image==0.26.0 libigl==2.6.3 PyMCubes==0.1.6 pyvista==0.49.1 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import igl
import mcubes
import numpy as np
import pyvista
from skimage.measure import marching_cubes

SIZE = 33
STEP = 2 / (SIZE - 1)
grid = np.mgrid[-1:1:33j, -1:1:33j, -1:1:33j]
distances = np.linalg.norm(grid, axis=0) - 0.5


def volume(vertices, faces):
    one, two, three = (np.asarray(vertices, float)[np.asarray(faces)[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", one, np.cross(two, three)) / 6)


def by_scikit_image(field, **options):
    vertices, faces, normals, _ = marching_cubes(field, 0, spacing=(STEP,) * 3, **options)
    return vertices - 1, faces, normals


def by_igl(field):
    places = np.stack([axis.ravel(order="F") for axis in grid], axis=1)
    return igl.marching_cubes(field.ravel(order="F"), places, SIZE, SIZE, SIZE)[:2]


def by_mcubes(field):
    vertices, faces = mcubes.marching_cubes(field, 0)
    return vertices * STEP - 1, faces


def by_pyvista(field, method):
    image = pyvista.ImageData(dimensions=field.shape, spacing=(STEP,) * 3, origin=(-1,) * 3)
    image["field"] = field.ravel(order="F")
    surface = image.contour([0], scalars="field", method=method)
    return surface.points, surface.faces.reshape(-1, 4)[:, 1:]


fields = {"distances": (distances, 1), "densities": (-distances, -1)}
for name, (field, sign) in fields.items():
    found = {}
    for direction in ("descent", "ascent"):
        vertices, faces, normals = by_scikit_image(field, gradient_direction=direction)
        outwards = (vertices * normals).sum(axis=1)
        found[f"scikit-image, {direction}"] = volume(vertices, faces), sign if direction == "descent" else -sign
        print(f"{name}: normals of scikit-image, {direction}: {outwards.min():.2f} to {outwards.max():.2f}")
        assert (outwards * -sign > 0.4).all()
    default, given = by_scikit_image(field), by_scikit_image(field, gradient_direction="descent")
    assert all(np.array_equal(one, other) for one, other in zip(default, given, strict=True))
    found["libigl"] = volume(*by_igl(field)), sign
    found["PyMCubes"] = volume(*by_mcubes(field)), -sign
    for method in ("contour", "marching_cubes", "flying_edges"):
        found[f"pyvista, {method}"] = volume(*by_pyvista(field, method)), -sign
    for package, (measured, expected) in found.items():
        print(f"{name}: {package}: volume {measured:.3f}")
        assert abs(measured - 0.52 * expected) < 0.01, package
PYTHON
echo "as described"
