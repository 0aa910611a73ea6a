import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from anystyle.geometry.cameras import smooth_path
from anystyle.types import Cameras


def orbit(count):
    angles = np.linspace(0, 1, count)
    pose = np.tile(np.eye(4), (count, 1, 1))
    pose[:, :3, :3] = Rotation.from_euler("y", -angles[:, None]).as_matrix()
    pose[:, :3, 3] = pose[:, :3, :3] @ [0, 0, -2.0]
    lens = torch.tensor([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])
    return Cameras(torch.tensor(pose, dtype=torch.float32)[None], lens.expand(1, count, 3, 3), (48, 64))


@pytest.mark.parametrize("count", [2, 3, 6])
def test_a_path_meets_its_cameras_and_stays_rigid(count):
    cameras = orbit(count)
    path = smooth_path(cameras, 1001)
    for view in range(count):
        apart = (path.world_from_camera - cameras.world_from_camera[:, view, None]).abs().amax((-1, -2))
        assert apart.min() < 5e-3
    rotations = path.world_from_camera[0, :, :3, :3]
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand(1001, 3, 3), rtol=0, atol=1e-5)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(1001), rtol=0, atol=1e-5)
    torch.testing.assert_close(path.world_from_camera[:, [0, -1]], cameras.world_from_camera[:, [0, -1]])


def test_a_path_is_smooth():
    positions = smooth_path(orbit(9), 200).world_from_camera[0, :, :3, 3]
    steps = positions.diff(dim=0).norm(dim=-1)
    assert steps.diff().abs().max() < 0.1 * steps.max()


def test_one_camera_sways_around_what_it_looks_at():
    path = smooth_path(orbit(1), 16)
    inverse = path.camera_from_world[0]
    target = torch.tensor([0.0, 0, -1, 1])  # one unit ahead of the camera at z = -2
    seen = inverse @ target
    torch.testing.assert_close(seen[:, :2] / seen[:, 2:3], torch.zeros(16, 2), rtol=0, atol=2e-3)
    assert path.world_from_camera[0, :, :3, 3].std(0)[:2].min() > 0.03


def test_impossible_paths_are_refused():
    with pytest.raises(ValueError, match="one scene"):
        smooth_path(orbit(3).expand(2), 5)
    with pytest.raises(ValueError, match="at least 1 frame"):
        smooth_path(orbit(3), 0)
