#!/usr/bin/env bash
# Colours of vertices in a GLB, as of 16 bits: trimesh 5.2.0 and pymeshlab 2025.7 keep the low byte; none is sRGB.
#
# glTF's COLOR_0 is linear, in floats or in whole numbers of 8 or 16 bits. Orange (1, 0.5, 0), a blue (0.04, 0.08, 1)
# and the linear value of a middle grey, 0.214, which is 127 of 255 on a screen:
#                                     float or 8 bits                             16 bits
#   trimesh, points and meshes        255, 128, 0; 10, 20, 255; 55                255, 0, 0; 61, 123, 255; 203
#   pymeshlab                         likewise; floats are cut, 127 for 0.5       likewise
#   VTK 9.7.2                         right                                       right
# None makes them sRGB: as colours of points or of Gaussians the grey of 127 is 55, and trimesh writes its bytes, which
# are sRGB when they come from a picture, back as linear. No warning. Take floats or bytes, and convert.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet trimesh==5.2.0 vtk==9.7.2 pymeshlab==2025.7.post1 pygltflib==1.16.5 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import io

import numpy as np
import pygltflib as gltf
import pymeshlab
import trimesh
import vtk
from vtk.util.numpy_support import vtk_to_numpy

colours = np.array([[1, 0.5, 0, 1], [0.04, 0.08, 1, 1], [0.21404, 0.21404, 0.21404, 1]])
POINTS, TRIANGLES = 0, 4


def write(kind, mode):
    top = 1 if kind == "f4" else np.iinfo(kind).max
    values = (colours.astype("f4") if top == 1 else (colours * top).round().astype(kind)).tobytes()
    places = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "f4").tobytes()
    part = gltf.Primitive(attributes=gltf.Attributes(POSITION=0, COLOR_0=1), mode=mode)
    number = {"f4": gltf.FLOAT, "u1": gltf.UNSIGNED_BYTE, "u2": gltf.UNSIGNED_SHORT}[kind]
    file = gltf.GLTF2(
        scene=0,
        scenes=[gltf.Scene(nodes=[0])],
        nodes=[gltf.Node(mesh=0)],
        meshes=[gltf.Mesh(primitives=[part])],
        accessors=[
            gltf.Accessor(bufferView=0, componentType=gltf.FLOAT, count=3, type="VEC3", min=[0, 0, 0], max=[1, 1, 0]),
            gltf.Accessor(bufferView=1, componentType=number, normalized=top > 1, count=3, type="VEC4"),
        ],
        bufferViews=[
            gltf.BufferView(buffer=0, byteLength=len(places), target=gltf.ARRAY_BUFFER),
            gltf.BufferView(buffer=0, byteOffset=36, byteLength=len(values), target=gltf.ARRAY_BUFFER),
        ],
        buffers=[gltf.Buffer(byteLength=36 + len(values))],
    )
    file.set_binary_blob(places + values)
    file.save("scene.glb")


def by_trimesh(file="scene.glb"):
    shape = next(iter(trimesh.load(file, file_type="glb").geometry.values()))
    return (shape.colors if hasattr(shape, "colors") else shape.visual.vertex_colors) / 255


def by_pymeshlab():
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh("scene.glb")
    return meshes.current_mesh().vertex_color_matrix()


def by_vtk():
    reader = vtk.vtkGLTFReader()
    reader.SetFileName("scene.glb")
    reader.Update()
    data = reader.GetOutput()
    while data.IsA("vtkMultiBlockDataSet"):
        data = data.GetBlock(0)
    return vtk_to_numpy(data.GetPointData().GetArray("COLOR_0"))


low = [[255, 0, 0], [61, 123, 255], [203, 203, 203]]
readers = {"trimesh": by_trimesh, "vtk": by_vtk, "pymeshlab": by_pymeshlab}
for mode, names in ((POINTS, ("trimesh", "vtk")), (TRIANGLES, readers)):
    for kind in ("f4", "u1", "u2"):
        write(kind, mode)
        for name in names:
            found = np.asarray(readers[name](), float)[:, :3] * 255
            print(f"{'points' if mode == POINTS else 'mesh':6} {kind} {name:12}", *found.round().astype(int).tolist())
            cut = kind == "u2" and name in ("trimesh", "pymeshlab")
            assert np.allclose(found, low if cut else colours[:, :3] * 255, atol=1.1)
grey = trimesh.PointCloud(np.eye(3), colors=np.full((3, 4), 127, np.uint8))
written = grey.export(file_type="glb")
file = gltf.GLTF2.load_from_bytes(written)
index = file.meshes[0].primitives[0].attributes.COLOR_0
view = file.bufferViews[file.accessors[index].bufferView]
stored = file.binary_blob()[view.byteOffset]
print("trimesh writes 127 of a picture as", stored, "and reads", by_trimesh(io.BytesIO(written))[0, 0] * 255)
assert file.accessors[index].componentType == gltf.UNSIGNED_BYTE and stored == 127
PYTHON
echo "as described"
