"""Camera paths that nerfstudio's viewer saves, ``camera_paths/*.json``."""

import math
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import torch
from jaxtyping import Float
from msgspec import Meta
from torch import Tensor

from anystyle.errors import UserError
from anystyle.io.documents import read_json
from anystyle.ranges import Positive
from anystyle.types import Cameras

FPS = 24.0
"""Of a path that says neither frames per second nor seconds."""
_Side = Annotated[int, Meta(ge=1, le=1 << 15)]


class _PathFrame(msgspec.Struct):
    camera_to_world: Annotated[list[float], Meta(min_length=16, max_length=16)]
    fov: Annotated[float, Meta(gt=0, lt=180)]


class _PathFile(msgspec.Struct):
    camera_path: Annotated[list[_PathFrame], Meta(max_length=100_000)]
    render_height: _Side
    render_width: _Side
    camera_type: str = "perspective"
    fps: Positive | None = None
    seconds: Positive | None = None


class CameraTrajectory(NamedTuple):
    """Cameras in the coordinates of the run's model, one per frame, and their times in seconds, from 0."""

    cameras: Cameras
    times: Float[Tensor, " V"]


def read_camera_path(path: Path) -> CameraTrajectory:
    """Read the frames of a path, which nerfstudio has interpolated between its keyframes.

    A frame has a pose with OpenGL's axes, by rows, and a vertical field of view in degrees.
    """
    content = read_json(path, _PathFile, what="camera path of nerfstudio")
    frames, height, width = content.camera_path, content.render_height, content.render_width
    if content.camera_type.lower() != "perspective":
        raise UserError(f"{path} is a path of a camera of type {content.camera_type!r}; save one of type perspective")
    if not frames:
        raise UserError(f"{path} has no frames; add keyframes in the viewer, and press Generate Command again")
    poses = torch.tensor([frame.camera_to_world for frame in frames], dtype=torch.float64).unflatten(1, (4, 4))
    turns = poses[:, :3, :3]
    rigid = (turns @ turns.mT - torch.eye(3)).abs().amax() < 1e-3 and bool((turns.det() > 0).all())
    if not rigid or not bool((poses[:, 3] == torch.eye(4)[3]).all()):
        raise UserError(f"{path}: camera_to_world of a frame is not a rotation and translation, by rows")
    matrices = torch.eye(3).repeat(len(frames), 1, 1)
    matrices[:, :2, 2] = torch.tensor([width / 2, height / 2])
    for matrix, frame in zip(matrices, frames, strict=True):
        matrix[0, 0] = matrix[1, 1] = height / 2 / math.tan(math.radians(frame.fov) / 2)
    fps = content.fps or (len(frames) / content.seconds if content.seconds else FPS)
    poses = (poses * torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64)).float()
    return CameraTrajectory(Cameras(poses[None], matrices[None], (height, width)), torch.arange(len(frames)) / fps)


def keyframes_of(path: CameraTrajectory) -> dict[str, object]:
    """A path as a file of keyframes, every frame one: seconds, poses with OpenCV's axes, fields of view in degrees."""
    fovs = 2 * torch.rad2deg(torch.atan(path.cameras.size[0] / 2 / path.cameras.intrinsics[0, :, 1, 1]))
    rows = zip(path.times.tolist(), path.cameras.world_from_camera[0].tolist(), fovs.tolist(), strict=True)
    return {"keyframes": [{"time": time, "world_from_camera": pose, "fov": fov} for time, pose, fov in rows]}
