"""Paths from files of keyframes.

::

    {
      "up": [0, -1, 0],
      "keyframes": [
        {"time": 0, "position": [0, 0, -0.5], "look_at": [0, 0, 2], "fov": 60},
        {"time": 2.5, "world_from_camera": [[1, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
      ]
    }

Coordinates are those of ``cameras.json``: OpenCV's axes (x right, y down, z forward) in the scene's own unit. ``time``
is in seconds; ``fov`` is the vertical field of view in degrees, by default the cameras'; ``up`` is for ``look_at``, by
default the scene's.
"""

from typing import Annotated

import msgspec
import numpy as np
import torch
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at
from anystyle.io.documents import read_json
from anystyle.types import Cameras
from anystyle_film.paths import FilmedScene

MAX_SECONDS = 3600.0
_Vector = tuple[float, float, float]
_Row = tuple[float, float, float, float]


class Keyframe(msgspec.Struct, forbid_unknown_fields=True):
    """A camera at a time: its position and what it looks at, or its pose."""

    time: Annotated[float, msgspec.Meta(ge=0, le=MAX_SECONDS)]
    position: _Vector | None = None
    look_at: _Vector | None = None
    world_from_camera: tuple[_Row, _Row, _Row, _Row] | None = None
    fov: Annotated[float, msgspec.Meta(ge=1, le=170)] | None = None


class KeyframesFile(msgspec.Struct, forbid_unknown_fields=True):
    """The file."""

    keyframes: Annotated[list[Keyframe], msgspec.Meta(min_length=1, max_length=10_000)]
    up: _Vector | None = None


class Keyframes:
    """A path through the keyframes of a JSON file, smooth in position, direction and field of view.

    Args:
        file: Its path.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self.document: KeyframesFile = read_json(file, KeyframesFile, what="file of keyframes")
        keys = self.document.keyframes
        self.times = np.array([key.time for key in keys]) - keys[0].time
        self.seconds = float(self.times[-1]) or None
        for index, key in enumerate(keys):
            where = f"{file}, keyframe {index + 1}"
            if index and self.times[index] <= self.times[index - 1]:
                raise UserError(f"{where}: time {key.time:g} is not after that of the one before; order them by time")
            given = [value is not None for value in (key.position, key.look_at, key.world_from_camera)]
            if given not in ([True, True, False], [False, False, True]):
                raise UserError(f"{where}: give either position and look_at, or world_from_camera")
            if given[0] and key.position == key.look_at:
                raise UserError(f"{where}: position and look_at are the same point")
            pose = np.array(key.world_from_camera if given[2] else np.eye(4))
            rigid = np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() < 1e-3 and np.linalg.det(pose[:3, :3]) > 0
            if not rigid or (pose[3] != [0, 0, 0, 1]).any():
                raise UserError(f"{where}: world_from_camera is not a rotation and translation above a row 0, 0, 0, 1")

    def __call__(self, scene: FilmedScene, frames: int) -> Cameras:
        """The cameras of the frames, evenly spaced in time."""
        poses = np.stack([self._pose(index, key, scene) for index, key in enumerate(self.document.keyframes)])
        height, width = scene.cameras.size
        mean = scene.cameras.intrinsics[0].double().mean(0).cpu().numpy()
        usual = 2 * np.degrees(np.arctan(height / 2 / mean[1, 1]))
        views = np.array([usual if key.fov is None else key.fov for key in self.document.keyframes])
        times, path = np.linspace(0, self.times[-1], frames), np.tile(np.eye(4), (frames, 1, 1))
        if len(poses) == 1:
            path[:], views = poses[0], np.repeat(views, frames)
        else:
            path[:, :3, 3] = PchipInterpolator(self.times, poses[:, :3, 3])(times)
            path[:, :3, :3] = RotationSpline(self.times, Rotation.from_matrix(poses[:, :3, :3]))(times).as_matrix()
            views = PchipInterpolator(self.times, views)(times)
        intrinsics = np.tile(np.eye(3), (frames, 1, 1))
        intrinsics[:, 1, 1] = height / 2 / np.tan(np.radians(views) / 2)
        intrinsics[:, 0, 0] = intrinsics[:, 1, 1] * mean[0, 0] / mean[1, 1]
        intrinsics[:, :2, 2] = width / 2, height / 2
        return scene.filmed_from(torch.from_numpy(path), torch.from_numpy(intrinsics))

    def _pose(self, index: int, key: Keyframe, scene: FilmedScene) -> np.ndarray:
        if key.world_from_camera is not None:
            return np.array(key.world_from_camera)
        eye, target = (torch.tensor(point, dtype=torch.float64) for point in (key.position, key.look_at))
        up = scene.up if self.document.up is None else torch.tensor(self.document.up, dtype=torch.float64)
        if torch.linalg.cross(target - eye, up).norm() <= 1e-6 * (target - eye).norm() * up.norm():
            raise UserError(f"{self.file}, keyframe {index + 1}: it looks along up; move it, or give world_from_camera")
        return look_at(eye, target, up).numpy()
