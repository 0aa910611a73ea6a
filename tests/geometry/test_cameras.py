import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from anystyle.geometry.cameras import look_at, smooth_path
from anystyle.types import Cameras


def ring(count):
    angles = np.linspace(0, 1, count)
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, :3] = Rotation.from_euler("y", -angles[:, None]).as_matrix()
    pose[:, :3, 3] = pose[:, :3, :3] @ [0, 0, -2.0]
    lens = torch.tensor([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])
    return Cameras(torch.tensor(pose, dtype=torch.float32)[None], lens.expand(1, count, 3, 3), (48, 64))


@pytest.mark.parametrize("count", [2, 3, 6])
def test_a_path_meets_its_cameras_and_stays_rigid(count):
    cameras = ring(count)
    path = smooth_path(cameras, 1001)
    for view in range(count):
        assert (path.world_from_camera - cameras.world_from_camera[:, view, None]).abs().amax((-1, -2)).min() < 5e-3
    rotations = path.world_from_camera[0, :, :3, :3]
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand(1001, 3, 3), rtol=0, atol=1e-5)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(1001), rtol=0, atol=1e-5)
    torch.testing.assert_close(path.world_from_camera[:, [0, -1]], cameras.world_from_camera[:, [0, -1]])


def test_of_cameras_in_one_place_a_path_takes_those_that_turn_least():
    places = ring(4)
    turn = torch.eye(4)
    turn[:3, :3] = torch.from_numpy(Rotation.from_euler("y", 2.0).as_matrix())
    around = torch.stack([places.world_from_camera, places.world_from_camera @ turn], 2)
    around[:, 1:] = around[:, 1:].flip(2)
    views = Cameras(around.flatten(1, 2), places.intrinsics.repeat(1, 2, 1, 1), places.size)
    torch.testing.assert_close(smooth_path(views, 9).world_from_camera, smooth_path(places, 9).world_from_camera)


def test_one_camera_sways_around_what_it_looks_at():
    path = smooth_path(ring(1), 16)
    inverse = path.camera_from_world[0]
    target = torch.tensor([0.0, 0, -1, 1])  # one unit ahead of the camera at z = -2
    seen = inverse @ target
    torch.testing.assert_close(seen[:, :2] / seen[:, 2:3], torch.zeros(16, 2), rtol=0, atol=2e-3)
    assert path.world_from_camera[0, :, :3, 3].std(0)[:2].min() > 0.03


def test_impossible_paths_are_refused():
    with pytest.raises(ValueError, match="one scene"):
        smooth_path(ring(3).expand(2), 5)
    with pytest.raises(ValueError, match="at least 1 frame"):
        smooth_path(ring(3), 0)


@given(st.tuples(*[st.floats(-5, 5)] * 3), st.tuples(*[st.floats(-5, 5)] * 3))
def test_what_is_looked_at_lies_on_the_axis_and_up_is_up(eye, target):
    eye, target = torch.tensor(eye, dtype=torch.float64), torch.tensor(target, dtype=torch.float64)
    way = target - eye
    if torch.linalg.cross(way, torch.tensor([0.0, 1, 0], dtype=torch.float64)).norm() < 0.1:
        return
    pose = look_at(eye, target)
    torch.testing.assert_close(pose[:3, :3].mT @ pose[:3, :3], torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(pose[:3, :3]).item() == pytest.approx(1)
    seen = torch.linalg.inv(pose) @ torch.cat([target, torch.ones(1, dtype=torch.float64)])
    torch.testing.assert_close(seen[:3], torch.tensor([0.0, 0, way.norm()], dtype=torch.float64), rtol=0, atol=1e-9)
    # A point above the target is seen above it: y points down in world and image alike.
    assert (torch.linalg.inv(pose) @ torch.cat([target - torch.tensor([0, 1.0, 0]), torch.ones(1)]).double())[1] < 0
