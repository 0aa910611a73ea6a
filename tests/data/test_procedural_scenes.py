"""The procedural scenes: geometry that is exact, bytes that are the same, pictures that are fit to learn from."""

import torch

from anystyle.data.procedural.scenes import ProceduralScenes
from anystyle.types import Views


def test_depth_and_poses_explain_the_colours_of_other_views():
    errors = []
    for scene in range(6):
        views = ProceduralScenes(size=64).read(scene, [1, 4])
        assert views.cameras is not None and views.depth is not None
        errors.append(_reprojection_error(views))
    assert torch.tensor(errors).median() < 0.02
    assert max(errors) < 0.05


def _reprojection_error(views: Views) -> float:
    """Median colour difference between a view and the other one seen through its depth, where both see the point."""
    depth, cameras = views.depth[0], views.cameras
    size = depth.shape[-1]
    grid = torch.arange(size) + 0.5
    v, u = torch.meshgrid(grid, grid, indexing="ij")
    k = cameras.intrinsics[0, 0]
    ray = torch.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], torch.ones_like(u), 1 / depth[0]], -1)
    local = (ray * depth[0][..., None]) @ (cameras.camera_from_world[0, 1] @ cameras.world_from_camera[0, 0]).T
    x, y, z = local[..., 0], local[..., 1], local[..., 2]
    place = torch.stack([x / z * k[0, 0] + k[0, 2], y / z * k[1, 1] + k[1, 2]], -1) / size * 2 - 1
    seen = torch.nn.functional.grid_sample(
        torch.cat([views.images[0, 1], depth[1:]])[None], place[None], align_corners=False
    )[0]
    visible = (place.abs() < 0.97).all(-1) & (z > 0) & ((seen[3] - z).abs() < 0.01 * z)
    assert visible.float().mean() > 0.25
    return (seen[:3] - views.images[0, 0]).abs().mean(0)[visible].median().item()
