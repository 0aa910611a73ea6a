"""Camera paths."""

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline
from torch import Tensor

from anystyle.types import Cameras

KEY_CAMERAS = 6
"""The most cameras that a path goes through: through more of them it follows the shake of a hand."""
SAME_PLACE = 1e-5
"""Steps shorter than this fraction of the longest one are rounding."""


def smooth_path(cameras: Cameras, frames: int) -> Cameras:
    """A smooth flight through the cameras of one scene, from the first to the last; a single camera sways in a circle.

    Positions are interpolated without overshoot, rotations with a continuous angular velocity. Of cameras in one place,
    as the views of a panorama, it goes through the one that turns least.
    """
    if cameras.intrinsics.shape[0] != 1 or frames < 1:
        raise ValueError(f"a path needs one scene and at least 1 frame, not {cameras.intrinsics.shape[0]} and {frames}")
    pose = cameras.world_from_camera[0].detach().double().cpu().numpy()
    intrinsics = cameras.intrinsics[0].detach().double().cpu().numpy()
    stops = _stops(pose)
    num_cameras = len(stops)
    if num_cameras == 1:
        path, path_intrinsics = _sway(pose[0], frames), np.repeat(intrinsics, frames, axis=0)
    else:
        keys = stops[np.unique(np.linspace(0, num_cameras - 1, min(num_cameras, KEY_CAMERAS)).round().astype(int))]
        key_times = np.linspace(0, 1, len(keys))
        # Slow at both ends, as a camera on a dolly.
        times = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, frames)) if frames > 1 else np.zeros(1)
        path = np.tile(np.eye(4), (frames, 1, 1))
        path[:, :3, 3] = PchipInterpolator(key_times, pose[keys, :3, 3])(times)
        path[:, :3, :3] = RotationSpline(key_times, Rotation.from_matrix(pose[keys, :3, :3]))(times).as_matrix()
        path_intrinsics = PchipInterpolator(key_times, intrinsics[keys])(times)
    poses, path_intrinsics = (torch.as_tensor(each)[None].to(cameras.intrinsics) for each in (path, path_intrinsics))
    return Cameras(poses, path_intrinsics, cameras.size)


def _stops(pose: np.ndarray) -> np.ndarray:
    """Indices of cameras, of successive ones in one place only that whose axis is nearest to that of the one before."""
    steps = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1)
    places = np.split(np.arange(len(pose)), 1 + np.flatnonzero(steps > SAME_PLACE * steps.max(initial=0)))
    stops = places[0][:1].tolist()
    for place in places[1:]:
        stops.append(place[(pose[place, :3, 2] @ pose[stops[-1], :3, 2]).argmax()])
    return np.array(stops) if len(stops) > 1 else np.arange(len(pose))


def look_at(
    eye: Float[Tensor, "*batch 3"], target: Float[Tensor, "*batch 3"], up: Float[Tensor, "3"] | None = None
) -> Float[Tensor, "*batch 4 4"]:
    """World from camera of cameras at ``eye`` that look at ``target``; ``up`` in the images is -y by default."""
    up = eye.new_tensor([0.0, -1.0, 0.0]) if up is None else up
    forward = torch.nn.functional.normalize(target - eye, dim=-1)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up.expand_as(forward), dim=-1), dim=-1)
    down = torch.linalg.cross(forward, right, dim=-1)
    bottom = eye.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*eye.shape[:-1], 1, 4)
    return torch.cat([torch.stack([right, down, forward, eye], dim=-1), bottom], dim=-2)


def _sway(pose: np.ndarray, frames: int, radius: float = 0.06) -> np.ndarray:
    """Once around a circle in the image plane, looking at what is straight ahead at unit distance."""
    angle = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    local = np.tile(np.eye(4), (frames, 1, 1))
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    local[:, 0, 3], local[:, 1, 3] = x, y
    local[:, :3, :3] = Rotation.from_euler("xy", np.stack([np.arctan(y), -np.arctan(x)], 1)).as_matrix()
    return pose @ local
