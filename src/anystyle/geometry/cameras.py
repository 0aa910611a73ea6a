"""Camera paths."""

import numpy as np
import torch
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline

from anystyle.types import Cameras

KEY_CAMERAS = 6
"""A path goes through at most so many of the cameras: more of them make it follow the shake of a hand."""


def smooth_path(cameras: Cameras, frames: int) -> Cameras:
    """A smooth flight through the cameras of one scene, from the first to the last.

    Positions are interpolated without overshoot, rotations with a continuous angular velocity. A single camera sways
    on a small circle around its place.

    Args:
        cameras: A batch of one scene.
        frames: How many cameras to return, at least 1.

    Raises:
        ValueError: There are several scenes, or no frame is asked for.
    """
    if cameras.intrinsics.shape[0] != 1 or frames < 1:
        raise ValueError(f"a path needs one scene and at least 1 frame, not {cameras.intrinsics.shape[0]} and {frames}")
    pose = cameras.world_from_camera[0].detach().double().cpu().numpy()
    intrinsics = cameras.intrinsics[0].detach().double().cpu().numpy()
    count = len(pose)
    if count == 1:
        flown, lenses = _sway(pose[0], frames), np.repeat(intrinsics, frames, axis=0)
    else:
        keys = np.unique(np.linspace(0, count - 1, min(count, KEY_CAMERAS)).round().astype(int))
        times = np.linspace(0, 1, len(keys))
        # Slow at both ends, as a camera on a dolly.
        when = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, frames)) if frames > 1 else np.zeros(1)
        flown = np.tile(np.eye(4), (frames, 1, 1))
        flown[:, :3, 3] = PchipInterpolator(times, pose[keys, :3, 3])(when)
        flown[:, :3, :3] = RotationSpline(times, Rotation.from_matrix(pose[keys, :3, :3]))(when).as_matrix()
        lenses = PchipInterpolator(times, intrinsics[keys])(when)
    like = cameras.intrinsics
    return Cameras(
        world_from_camera=torch.as_tensor(flown, dtype=like.dtype, device=like.device)[None],
        intrinsics=torch.as_tensor(lenses, dtype=like.dtype, device=like.device)[None],
        size=cameras.size,
    )


def _sway(pose: np.ndarray, frames: int, radius: float = 0.06) -> np.ndarray:
    """Once around a circle in the image plane, looking at what is straight ahead at unit distance."""
    turn = np.linspace(0, 2 * np.pi, frames, endpoint=False)
    local = np.tile(np.eye(4), (frames, 1, 1))
    offset = radius * np.stack([np.cos(turn), np.sin(turn), np.zeros(frames)], axis=1)
    local[:, :3, 3] = offset
    local[:, :3, :3] = Rotation.from_euler(
        "xy", np.stack([np.arctan(offset[:, 1]), -np.arctan(offset[:, 0])], 1)
    ).as_matrix()
    return pose @ local
