"""What teaches geometry, against closed forms."""

import math
from dataclasses import replace

import pytest
import torch

from anystyle.testing.oracle import hashed
from anystyle.types import Cameras, Geometry, Views
from anystyle_tiny.training.matches import patch_matches
from anystyle_tiny.training.reconstruction import geometry_errors, psnr
from anystyle_tiny.training.supervision import (
    camera_loss,
    canonical,
    depth_loss,
    huber,
    point_loss,
    project,
    transfer_loss,
)

SIZE = 24


def turned(degrees: float, axis: int = 1) -> torch.Tensor:
    angle = math.radians(degrees)
    first, second = [i for i in range(3) if i != axis]
    matrix = torch.eye(4)
    matrix[first, first] = matrix[second, second] = math.cos(angle)
    matrix[first, second], matrix[second, first] = math.sin(angle), -math.sin(angle)
    return matrix


def cameras(*poses: torch.Tensor, focal: float = 20.0) -> Cameras:
    intrinsics = torch.tensor([[focal, 0, SIZE / 2], [0, focal, SIZE / 2], [0, 0, 1]])
    return Cameras(torch.stack(poses)[None], intrinsics.expand(1, len(poses), 3, 3).clone(), (SIZE, SIZE))


def moved(x: float, y: float = 0.0, z: float = 0.0) -> torch.Tensor:
    pose = torch.eye(4)
    pose[:3, 3] = torch.tensor([x, y, z])
    return pose


def wall(*poses: torch.Tensor, distance: float = 2.0) -> Views:
    """A wall straight ahead of cameras that all look along z."""
    count = len(poses)
    depth = torch.stack([torch.full((SIZE, SIZE), distance) - pose[2, 3] for pose in poses])[None]
    return Views(images=hashed(3, (1, count, 3, SIZE, SIZE)), cameras=cameras(*poses), depth=depth)


def test_the_canonical_frame_does_not_know_where_the_world_was_nor_how_large():
    views = wall(moved(0), moved(0.3), moved(0, 0.1, 0.2))
    world, scale = turned(40) @ moved(1, 2, 3), 2.5
    poses = views.cameras.world_from_camera.clone()
    poses[..., :3, 3] *= scale
    far = replace(views, cameras=replace(views.cameras, world_from_camera=world @ poses), depth=views.depth * scale)
    one, other = canonical(views, 2), canonical(far, 2)
    torch.testing.assert_close(one.depth, other.depth)
    torch.testing.assert_close(one.cameras.world_from_camera, other.cameras.world_from_camera, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(one.cameras.world_from_camera[:, 0], torch.eye(4)[None], atol=1e-6, rtol=0)
    points = Geometry(one.cameras, one.depth, one.depth).points()[:, :2]
    torch.testing.assert_close(points.norm(dim=-1).mean(), torch.tensor(1.0))


def test_scenes_without_depth_are_refused():
    with pytest.raises(ValueError, match="cameras and depth"):
        canonical(Views(images=torch.zeros(1, 2, 3, 8, 8)), 2)


def test_depth_loss_of_a_constant_factor_is_its_logarithm():
    true = 1 + hashed(5, (1, 2, 8, 8))
    true[0, 0, 0, 0] = 0
    one = torch.ones_like(true)
    found = depth_loss(true.clamp_min(0.5) * 1.5, one, true)
    torch.testing.assert_close(found, torch.tensor(math.log(1.5)))
    # The reward of confidence c is alpha log c, its price c times the error: best at alpha / error.
    confident = [depth_loss(true.clamp_min(0.5) * 1.5, c * one, true) for c in (0.3, 0.2 / math.log(1.5), 0.8)]
    assert confident[1] < confident[0] and confident[1] < confident[2]


def test_camera_errors_vanish_at_the_truth_and_are_chordal():
    true = cameras(torch.eye(4), turned(10))
    assert camera_loss(true, true) < 1e-3
    off = cameras(torch.eye(4), turned(40))
    chord = 2 * math.sqrt(2) * math.sin(math.radians(15))
    expected = (huber(torch.tensor(chord)) + huber(torch.tensor(1e-4))) / 2
    torch.testing.assert_close(camera_loss(off, true), expected)
    focal = camera_loss(cameras(torch.eye(4), turned(10), focal=30.0), true)
    torch.testing.assert_close(focal, torch.tensor(math.log(1.5)), atol=1e-3, rtol=0)


def test_transfer_and_point_losses_know_the_truth_and_how_far_a_camera_moved():
    views = wall(moved(0), moved(0.3))
    assert transfer_loss(views.cameras, views.cameras, views.depth) == 0
    assert point_loss(Geometry(views.cameras, views.depth, views.depth), views.cameras, views.depth) < 1e-6
    off = cameras(moved(0), moved(0.3 + 0.2))
    # The second camera alone is off, by 0.2 at depth 2: a share of 0.1, less half the rounding width of 0.05.
    torch.testing.assert_close(
        transfer_loss(off, views.cameras, views.depth), torch.tensor((0.1 - 0.025) / 2), atol=1e-5, rtol=0
    )


def test_projection_undoes_unprojection():
    views = wall(moved(0), turned(7) @ moved(0.1))
    world = Geometry(views.cameras, views.depth, views.depth).points()
    pixel, depth = project(views.cameras, world[:, 1].flatten(1, 2))
    centre = torch.arange(SIZE) + 0.5
    expected = torch.stack(torch.meshgrid(centre, centre, indexing="xy"), dim=-1).flatten(0, 1)
    torch.testing.assert_close(pixel[0, 1], expected, atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(depth[0, 1], views.depth[0, 1].flatten(), atol=1e-4, rtol=1e-4)


def test_matches_of_a_wall_are_the_shift_of_the_camera():
    # 0.3 to the right at depth 2 with a focal length of 20 pixels: points move 3 pixels to the left.
    views = wall(moved(0), moved(0.3))
    matches = patch_matches(views.cameras, views.depth, (4, 4))
    torch.testing.assert_close(matches.shift[0, 1, :, 0], torch.full((16,), 3 * 2 / SIZE), atol=1e-5, rtol=0)
    torch.testing.assert_close(matches.shift[0, :, :, 1], torch.zeros(2, 16), atol=1e-5, rtol=0)
    # Patch centres lie at 3.5, 9.5, ...: three pixels on, all but the last are in the next patch's first half.
    assert matches.target[0, 1].view(4, 4)[:, :3].tolist() == [
        [row * 4 + 1, row * 4 + 2, row * 4 + 3] for row in range(4)
    ]
    assert matches.visible[0, 1].view(4, 4)[:, :3].all()
    assert torch.equal(matches.target[0, 0], torch.arange(16)) and matches.visible[0, 0].all()


def test_hidden_points_have_no_match():
    views = wall(moved(0), moved(0.3))
    depth = views.depth.clone()
    depth[0, 0] = 1.0
    assert not patch_matches(views.cameras, depth, (4, 4)).visible[0, 1].any()


def test_errors_are_in_degrees_and_depth_is_judged_after_one_scale():
    true = wall(moved(0), turned(10) @ moved(0.5))
    found = Geometry(cameras(moved(0), turned(25) @ moved(0.5)), true.depth * 3, true.depth)
    errors = geometry_errors(found, true)
    torch.testing.assert_close(errors["depth_abs_rel"], torch.tensor(0.0), atol=1e-6, rtol=0)
    torch.testing.assert_close(errors["rotation_error_median_deg"], torch.tensor(15.0), atol=1e-3, rtol=0)
    assert geometry_errors(replace(found, cameras=true.cameras), true)["translation_direction_error_median_deg"] < 0.1


def test_psnr_of_a_constant_error():
    images = torch.full((1, 2, 3, 4, 4), 0.5)
    torch.testing.assert_close(psnr(images + 0.1, images), torch.full((1, 2), 20.0))
