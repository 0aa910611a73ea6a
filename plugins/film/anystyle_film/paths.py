"""Paths that follow from the cameras of a capture."""

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F

from anystyle.geometry.cameras import look_at, smooth_path
from anystyle.types import Cameras
from anystyle_film.scene import FilmedScene

NEAR = 0.25
"""The largest radius of a spiral, in distances to the scene: further away from the cameras nothing was photographed."""


CameraPath = Callable[[FilmedScene, int], Cameras]
"""From a scene and a number of frames to one camera per frame, for images of the size of the scene's cameras."""


def smooth(scene: FilmedScene, frames: int) -> Cameras:
    """A smooth flight through the cameras, from the first to the last."""
    return smooth_path(scene.cameras, frames)


def orbit(scene: FilmedScene, frames: int, turns: float = 1.0) -> Cameras:
    """A circle around what the cameras look at, at their mean distance and height; for captures that go around.

    Args:
        scene: What is filmed.
        frames: How many cameras.
        turns: Whole circles; a part of one has the cameras' mean direction in its middle. Below 0 is the other way.
    """
    center, up = scene.focus, scene.up
    offsets = scene.poses[:, :3, 3] - center
    radius = offsets.norm(dim=1).mean().clamp_min(1e-6)
    rise = torch.asin((offsets @ up / offsets.norm(dim=1).clamp_min(1e-6)).clamp(-0.99, 0.99)).mean()
    towards = _level(offsets.mean(0), up)
    aside = torch.linalg.cross(up, towards)
    # A whole turn begins at the cameras' mean direction, and a part of one has it in its middle.
    begin = -math.pi * turns if abs(turns) < 1 else 0.0
    angle = begin + 2 * math.pi * turns * torch.arange(frames).to(up)[:, None] / frames
    eye = center + radius * (rise.cos() * (angle.cos() * towards + angle.sin() * aside) + rise.sin() * up)
    return scene.filmed_from(look_at(eye, center.expand_as(eye), up))


def spiral(scene: FilmedScene, frames: int, turns: float = 2.0) -> Cameras:
    """A spiral about the mean camera that looks at one point, as LLFF has it; for captures from one side.

    Args:
        scene: What is filmed.
        frames: How many cameras.
        turns: Whole circles; below 0 is the other way.
    """
    poses, up = scene.poses, scene.up
    middle, forward = poses[:, :3, 3].mean(0), F.normalize(poses[:, :3, 2].mean(0), dim=0)
    axes = look_at(middle, middle + forward, up)[:3, :3]
    spread = ((poses[:, :3, 3] - middle) @ axes).abs().quantile(0.9, dim=0)
    radii = spread.clamp(0.02 * scene.distance, NEAR * scene.distance)
    angle = 2 * math.pi * turns * torch.arange(frames).to(up) / frames
    circle = torch.stack([angle.cos(), -angle.sin(), -(angle / 2).sin()], dim=1)
    eye = middle + (circle * radii) @ axes.T
    target = middle + scene.distance * forward
    return scene.filmed_from(look_at(eye, target.expand_as(eye), up))


def _level(direction: torch.Tensor, up: torch.Tensor) -> torch.Tensor:
    """The horizontal part of a direction, or any horizontal direction where it has none."""
    flat = direction - (direction @ up) * up
    if flat.norm() < 1e-6 * direction.norm().clamp_min(1e-6):
        flat = torch.linalg.cross(up, torch.eye(3).to(up)[int(up.abs().argmin())])
    return F.normalize(flat, dim=0)
