"""What a path promises: see :class:`anystyle_film.contract.CameraPath`."""

import torch

from anystyle.testing import asserts
from anystyle.testing.inputs import cameras, gaussians
from anystyle.testing.subject import Subject
from anystyle.types import Cameras
from anystyle_film.contract import CameraPath
from anystyle_film.scene import FilmedScene

SIZE = (48, 64)


def test_gives_one_camera_a_frame(plugin: Subject[CameraPath]) -> None:
    """Of any number of cameras it makes as many as frames are asked for, rigid and of the same size."""
    for number in (1, 2, 9):
        for frames in (1, 2, 25):
            path = _path(plugin, number, frames)
            assert path.intrinsics.shape[:2] == (1, frames), f"{list(path.intrinsics.shape)} for {frames} frames"
            asserts.cameras(path, SIZE)
            asserts.finite(path, f"the path of {frames} frames")


def test_moves_smoothly(plugin: Subject[CameraPath]) -> None:
    """With twice the frames no step is much longer: from frame to frame nothing jumps."""
    for parts in (lambda path: path.world_from_camera[0, :, :3, 3], lambda path: path.world_from_camera[0, :, :3, 2]):
        coarse, fine = (parts(_path(plugin, 5, frames)).diff(dim=0).norm(dim=1).max() for frames in (60, 120))
        assert fine <= 0.7 * coarse + 1e-4, f"steps of up to {fine:.3g} in 120 frames, and {coarse:.3g} in 60"


def test_gives_the_same_twice(plugin: Subject[CameraPath]) -> None:
    """The same cameras give the same path."""
    asserts.same(_path(plugin, 3, 8), _path(plugin, 3, 8), "the path of a second call")


def _path(plugin: Subject[CameraPath], number: int, frames: int) -> Cameras:
    with torch.no_grad():
        return plugin.instance(FilmedScene(gaussians(1, 50), cameras(1, number, SIZE)), frames)
