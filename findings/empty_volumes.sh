#!/usr/bin/env bash
# Depth fused by Open3D 0.20.0: ScalableTSDFVolume stays empty, and VoxelBlockGrid.ray_cast is half a voxel too deep.
#
# One view of 160 x 120 pixels of a plane that faces it, voxels of 0.02. Guessed: all agree to a hundredth of a voxel.
#                                                         plane at 0.25      0.5, 1, 3
#   pipelines.integration UniformTSDFVolume               right              right
#                         ScalableTSDFVolume              right              nothing: no vertex, no point
#   t.geometry VoxelBlockGrid, extracted points, mesh     right              right
#                              ray_cast, depth            0 to 1 voxel too far, 0.5 on average
#                              ray_cast, normals          away from the camera; those of extracted points towards it
# ScalableTSDFVolume takes the depth of an RGBD image, which is in units of the scene, for thousandths of them where it
# makes room for voxels, as create_from_depth_image of this version does by default. So only what lies within a block
# (16 voxels, 0.32) of a camera is fused, without a word, from depth of 16 bits, too: a mesh of depth that was rendered
# from Gaussians is empty or lacks what is farther. In 0.19.0 it was right; ray_cast was off by as much. Use
# VoxelBlockGrid, with a depth_scale of 1 for such depth, or UniformTSDFVolume, and extract the surface to render depth
# from it.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet open3d==0.20.0 numpy==2.2.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import open3d as o3d

WIDTH, HEIGHT, VOXEL = 160, 120, 0.02
lens = o3d.camera.PinholeCameraIntrinsic(WIDTH, HEIGHT, 150.0, 150.0, 79.5, 59.5)
matrix, pose = o3d.core.Tensor(lens.intrinsic_matrix), o3d.core.Tensor(np.eye(4))
grey = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
fusion = o3d.pipelines.integration
BYTES = fusion.TSDFVolumeColorType.RGB8


def fused(depth, scale):
    view = o3d.geometry.RGBDImage.create_from_color_and_depth(
        o3d.geometry.Image(grey), o3d.geometry.Image(depth), depth_scale=scale, depth_trunc=5.0,
        convert_rgb_to_intensity=False)
    assert np.allclose(view.depth, depth / scale)
    volumes = {"uniform": fusion.UniformTSDFVolume(5.12, 256, 4 * VOXEL, BYTES, origin=np.array([-2.56, -2.56, 0])),
               "scalable": fusion.ScalableTSDFVolume(VOXEL, 4 * VOXEL, BYTES)}
    for name, volume in volumes.items():
        volume.integrate(view, lens, np.eye(4))
        vertices, points = np.asarray(volume.extract_triangle_mesh().vertices), volume.extract_point_cloud().points
        assert bool(len(vertices)) == bool(len(points))
        yield name, vertices


for far in (0.25, 0.5, 1.0, 3.0):
    for name, vertices in fused(np.full((HEIGHT, WIDTH), far, np.float32), 1.0):
        print(f"plane at {far}, {name}: {len(vertices)} vertices")
        if name == "scalable" and far > 0.3:
            assert not len(vertices)
        else:
            assert np.allclose(vertices[:, 2], far, atol=0.01 * VOXEL)
for name, vertices in fused(np.full((HEIGHT, WIDTH), 1003, np.uint16), 1000.0):
    print(f"plane at 1.003, 16 bits, {name}: {len(vertices)} vertices")
    assert bool(len(vertices)) == (name == "uniform")

behind = []
for far in np.arange(1.007, 1.2, 0.00731):
    depth = o3d.t.geometry.Image(np.full((HEIGHT, WIDTH), far, np.float32))
    colour = o3d.t.geometry.Image(np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    grid = o3d.t.geometry.VoxelBlockGrid(("tsdf", "weight", "color"), (o3d.core.float32,) * 3, (1, 1, 3), VOXEL, 16, 500)
    blocks = grid.compute_unique_block_coordinates(depth, matrix, pose, 1.0, 5.0)
    grid.integrate(blocks, depth, colour, matrix, pose, 1.0, 5.0)
    cloud, mesh = grid.extract_point_cloud(0.5), grid.extract_triangle_mesh(0.5)
    places = cloud.point.positions.numpy()
    assert np.allclose(places[:, 2], far, atol=0.01 * VOXEL)
    assert np.allclose(mesh.vertex.positions.numpy()[:, 2], far, atol=0.01 * VOXEL)
    cast = grid.ray_cast(blocks, matrix, pose, WIDTH, HEIGHT, ["depth", "normal"], 1.0, 0.1, 5.0, 0.5)
    seen = cast["depth"].numpy()[40:80, 50:110]
    assert seen.min() > 0
    behind.append((seen.mean() - far) / VOXEL)
    assert np.median(cast["normal"].numpy()[40:80, 50:110, 2]) > 0.99
    assert np.median(cloud.point.normals.numpy()[:, 2]) < -0.99
behind = np.array(behind)
print(f"ray_cast: {behind.min():.2f} to {behind.max():.2f} voxels too far, {behind.mean():.2f} on average")
assert -0.01 < behind.min() < 0.1 and 0.9 < behind.max() < 1.05 and 0.4 < behind.mean() < 0.6
PYTHON
echo "as described"
