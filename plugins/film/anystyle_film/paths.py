"""What is filmed, and paths that follow from the cameras of its capture."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.cameras import look_at, smooth_path
from anystyle.types import Cameras, Gaussians

NEAR = 0.25
"""The largest radius of a spiral, in distances to the scene: further away from the cameras nothing was photographed."""
OPAQUE = 0.1
"""Gaussians of a lower opacity do not count as surface."""
UPRIGHT, AHEAD = 0.02, 0.02
"""Weights of what is assumed where cameras leave it open: up is that of their images, and the focus is ahead."""


@dataclass(frozen=True)
class FilmedScene:
    """A scene, and the cameras it was made from; all lengths are in its own unit.

    Args:
        gaussians: A batch of one scene.
        cameras: At least one.
        photographed: Whether cameras are those of photographs.
    """

    gaussians: Gaussians
    cameras: Cameras
    photographed: bool = True

    @property
    def poses(self) -> Float[Tensor, "V 4 4"]:
        """World from camera, in double precision on the CPU."""
        return self.cameras.world_from_camera[0].detach().double().cpu()

    @cached_property
    def up(self) -> Float[Tensor, "3"]:
        """The direction that is up: at right angles to the horizontal axes of all images, as hands hold cameras."""
        right, mean = self.poses[:, :3, 0], F.normalize(-self.poses[:, :3, 1].mean(0), dim=0)
        matrix = right.T @ right / len(right) + UPRIGHT * (torch.eye(3).to(mean) - torch.outer(mean, mean))
        up = torch.linalg.eigh(matrix).eigenvectors[:, 0]
        return up * (1.0 if up @ mean > 0 else -1.0)

    @cached_property
    def distance(self) -> float:
        """From a camera to what it sees, the median over cameras; 1 where they see nothing."""
        means = self.gaussians.means[0, self.gaussians.opacities[0] > OPAQUE].double().cpu()
        height, width = self.cameras.size
        depths = []
        for pose, intrinsics in zip(self.poses, self.cameras.intrinsics[0].double().cpu(), strict=True):
            local = (means - pose[:3, 3]) @ pose[:3, :3]
            local = local[local[:, 2] > 0]
            x, y, z = (local @ intrinsics.T).unbind(1)
            depth = z[(x > 0) & (x < width * z) & (y > 0) & (y < height * z)]
            depths += [depth.median()] if len(depth) else []
        return float(torch.stack(depths).median()) if depths else 1.0

    @cached_property
    def focus(self) -> Float[Tensor, "3"]:
        """The point nearest to all optical axes; where these are parallel, that ahead of their mean at the distance."""
        eyes, forward = self.poses[:, :3, 3], self.poses[:, :3, 2]
        across = torch.eye(3).to(eyes) - forward[:, :, None] * forward[:, None, :]  # projects to an axis's plane
        ahead = (eyes + self.distance * forward).mean(0)
        matrix = across.mean(0) + AHEAD * torch.eye(3).to(eyes)
        return torch.linalg.solve(matrix, (across @ eyes[..., None])[..., 0].mean(0) + AHEAD * ahead)

    def filmed_from(self, poses: Float[Tensor, "V 4 4"], intrinsics: Float[Tensor, "V 3 3"] | None = None) -> Cameras:
        """Cameras of a path; with the mean intrinsics of the scene's cameras unless others are given."""
        like = self.cameras.intrinsics
        if intrinsics is None:
            intrinsics = like[0].mean(0).expand(len(poses), 3, 3)
        return Cameras(poses.to(like)[None], intrinsics.to(like)[None], self.cameras.size)


CameraPath = Callable[[FilmedScene, int], Cameras]
"""From a scene and a number of frames to one camera per frame, for images of the size of the scene's cameras."""


def smooth(scene: FilmedScene, frames: int) -> Cameras:
    """A smooth flight through the cameras, from the first to the last."""
    return smooth_path(scene.cameras, frames)


def orbit(scene: FilmedScene, frames: int, turns: float = 1.0) -> Cameras:
    """A circle around what the cameras look at, at their mean distance and height; for captures that go around.

    Below 0, ``turns`` are the other way; a part of one has the cameras' mean direction in its middle.
    """
    center, up = scene.focus, scene.up
    offsets = scene.poses[:, :3, 3] - center
    radius = offsets.norm(dim=1).mean().clamp_min(1e-6)
    rise = torch.asin((offsets @ up / offsets.norm(dim=1).clamp_min(1e-6)).clamp(-0.99, 0.99)).mean()
    towards = _level(offsets.mean(0), up)
    aside = torch.linalg.cross(up, towards)
    begin = -math.pi * turns if abs(turns) < 1 else 0.0
    angle = begin + 2 * math.pi * turns * torch.arange(frames).to(up)[:, None] / frames
    eye = center + radius * (rise.cos() * (angle.cos() * towards + angle.sin() * aside) + rise.sin() * up)
    return scene.filmed_from(look_at(eye, center.expand_as(eye), up))


def spiral(scene: FilmedScene, frames: int, turns: float = 2.0) -> Cameras:
    """A spiral about the mean camera that looks at one point, as LLFF has it; for captures from one side."""
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
