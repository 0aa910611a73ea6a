#!/usr/bin/env bash
# Coloured points from a textured mesh, as to begin Gaussians with: upside down by one of Open3D's two halves.
#
# A square, whose texture is red and green above blue and white, as OBJ and as GLB. Points on it are
#   Open3D 0.20.0, open3d.io, sample_points_uniformly       right
#                  open3d.t.io, sample_points_uniformly     blue and white above red and green: row 0 of the texture is
#                                                           taken for v = 0. open3d.io turns it over when it reads
#                  open3d.t.geometry.TriangleMesh.from_legacy of the first    likewise
#                  a mesh made of arrays, in both           likewise: give the texture bottom row first
#   trimesh 5.2.0, sample_surface(sample_color=True)        right of OBJ; of GLB an AttributeError
#   pymeshlab 2025.7.post1, generate_sampling_montecarlo    white; generate_sampling_texel is right (GLB)
# No warning. Of a scan whose texture is an atlas, colours are those of other places.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet open3d==0.20.0 trimesh==5.2.0 pymeshlab==2025.7.post1 numpy==2.4.6 \
    pillow==12.3.0 scipy==1.17.1
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import open3d
import pymeshlab
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals, material

RED, GREEN, BLUE, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)
RIGHT, OVER, PLAIN = [RED, GREEN, BLUE, WHITE], [BLUE, WHITE, RED, GREEN], [WHITE] * 4
texture = np.array([[RED, GREEN], [BLUE, WHITE]], np.uint8).repeat(32, 0).repeat(32, 1)
corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
faces = np.array([[0, 1, 2], [0, 2, 3]])
for name, look in {
    "square.obj": material.SimpleMaterial(image=Image.fromarray(texture)),
    "square.glb": material.PBRMaterial(baseColorTexture=Image.fromarray(texture)),
}.items():
    visual = TextureVisuals(uv=corners[:, :2], material=look)
    trimesh.Trimesh(corners, faces, visual=visual, process=False).export(name)


def quarters(points, colours):
    colours = np.asarray(colours, float)[:, :3] * (255 if np.max(colours) <= 1 else 1)
    found = []
    for x, y in ((0.25, 0.75), (0.75, 0.75), (0.25, 0.25), (0.75, 0.25)):
        near = (np.abs(np.asarray(points)[:, :2] - (x, y)) < 0.2).all(1)
        found.append(tuple(int(value) for value in np.median(colours[near], 0).round()))
    return found


def legacy(mesh):
    cloud = mesh.sample_points_uniformly(4000)
    return quarters(cloud.points, cloud.colors)


def tensor(mesh):
    cloud = mesh.sample_points_uniformly(4000)
    return quarters(cloud.point.positions.numpy(), cloud.point.colors.numpy())


def check(name, found, expected):
    print(f"{name:45} {found}")
    assert found == expected


for name in ("square.obj", "square.glb"):
    mesh = open3d.io.read_triangle_mesh(name, True)
    check(f"open3d.io, {name}", legacy(mesh), RIGHT)
    check(f"open3d.t.io, {name}", tensor(open3d.t.io.read_triangle_mesh(name)), OVER)
    check(f"from_legacy, {name}", tensor(open3d.t.geometry.TriangleMesh.from_legacy(mesh)), OVER)
made = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(corners), open3d.utility.Vector3iVector(faces))
made.triangle_uvs = open3d.utility.Vector2dVector(corners[faces].reshape(-1, 3)[:, :2])
made.triangle_material_ids = open3d.utility.IntVector([0, 0])
for rows, expected in ((texture, OVER), (texture[::-1].copy(), RIGHT)):
    made.textures = [open3d.geometry.Image(rows)]
    check("open3d.geometry, of arrays", legacy(made), expected)
    new = open3d.t.geometry.TriangleMesh(
        open3d.core.Tensor(corners.astype(np.float32)), open3d.core.Tensor(faces.astype(np.int32))
    )
    new.triangle.texture_uvs = open3d.core.Tensor(corners[faces][..., :2].astype(np.float32))
    new.material.set_default_properties()
    new.material.texture_maps["albedo"] = open3d.t.geometry.Image(open3d.core.Tensor(rows))
    check("open3d.t.geometry, of arrays", tensor(new), expected)
points, _, colours = trimesh.sample.sample_surface(trimesh.load("square.obj", force="mesh"), 4000, sample_color=True)
check("trimesh, square.obj", quarters(points, colours), RIGHT)
try:
    trimesh.sample.sample_surface(trimesh.load("square.glb", force="mesh"), 4000, sample_color=True)
except AttributeError as error:
    print("trimesh, square.glb:", error)
else:
    raise AssertionError
for sample, options, expected in (
    ("montecarlo", {"samplenum": 4000}, PLAIN),
    ("texel", {"texturew": 64, "textureh": 64}, RIGHT),
):
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh("square.glb")
    getattr(meshes, f"generate_sampling_{sample}")(**options)
    cloud = meshes.current_mesh()
    check(f"pymeshlab, {sample}", quarters(cloud.vertex_matrix(), cloud.vertex_color_matrix()), expected)
PYTHON
echo "as described"
