"""A camera that moves to the right: the smallest path."""

import torch

from anystyle.types import Cameras
from anystyle_film.contract import CameraPath
from anystyle_film.scene import FilmedScene


class ToyCameraPath(CameraPath):
    """To the right of the first camera.

    Args:
        way: How far, in scene units.
    """

    def __init__(self, *, way: float = 0.1) -> None:
        self.way = way

    def __call__(self, scene: FilmedScene, frames: int) -> Cameras:
        poses = scene.poses[:1].repeat(frames, 1, 1)
        poses[:, :3, 3] += torch.linspace(0, self.way, frames)[:, None] * poses[:, :3, 0]
        return scene.filmed_from(poses)
