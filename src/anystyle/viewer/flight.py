"""A camera's flight: keyframes from a browser, a preview in it, and a film."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import viser
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.geometry.cameras import smooth_path
from anystyle.geometry.rotations import matrix_from_wxyz
from anystyle.io.video import write_video
from anystyle.types import Cameras, Gaussians

FPS, PREVIEW_FPS = 30, 15

Render = Callable[[Gaussians, Cameras], Iterator[Float[Tensor, "3 H W"]]]


class Flight:
    """Keyframes and what is made of them.

    Args:
        cameras: Of the photographs; the path goes through them while there are no keyframes.
        unstyled: The scene, for its distance.
        render: Renders cameras one by one.
    """

    def __init__(self, cameras: Cameras, unstyled: Gaussians, render: Render) -> None:
        self.cameras, self._render = cameras.to("cpu"), render
        self._keys: list[Float[Tensor, "4 4"]] = []
        pose = cameras.camera_from_world[0, 0]
        depth = (unstyled.means[0] @ pose[:3, :3].mT + pose[:3, 3])[:, 2]
        self.distance = float(depth[depth > 0].median()) if bool((depth > 0).any()) else 1.0

    @property
    def field_of_view(self) -> float:
        """Vertical, of the first camera, in radians."""
        return 2 * math.atan(self.cameras.size[0] / 2 / float(self.cameras.intrinsics[0, 0, 1, 1]))

    def pixel_variances(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """What a renderer's low-pass filter of 0.3 pixels² adds to Gaussians, as the first camera sees them.

        A browser's window is larger than the photographs were; without it gaps would open between Gaussians.
        """
        pose = self.cameras.camera_from_world[0, 0].to(means)
        depth = (means @ pose[2, :3] + pose[2, 3]).abs()
        return 0.3 * (depth / float(self.cameras.intrinsics[0, 0, 0, 0])).square()

    def add(self, camera: viser.CameraHandle) -> int:
        """Keep where a browser looks from; returns how many keyframes there are."""
        self._keys.append(pose_of(camera))
        return len(self._keys)

    def clear(self) -> int:
        """Forget all keyframes."""
        self._keys.clear()
        return 0

    def path(self, frames: int) -> Cameras:
        """The flight, smooth."""
        cameras = self.cameras
        if self._keys:
            count = len(self._keys)
            intrinsics = cameras.intrinsics[:, :1].expand(1, count, 3, 3)
            cameras = replace(cameras, world_from_camera=torch.stack(self._keys)[None], intrinsics=intrinsics)
        return smooth_path(cameras, frames)

    def preview(self, client: viser.ClientHandle, seconds: int) -> None:
        """Fly one browser's camera along the path."""
        for pose in self.path(seconds * PREVIEW_FPS).world_from_camera[0].double().numpy():
            with client.atomic():
                client.camera.position = pose[:3, 3]
                client.camera.up_direction = -pose[:3, 1]
                client.camera.look_at = pose[:3, 3] + pose[:3, 2] * self.distance
            client.flush()
            time.sleep(1 / PREVIEW_FPS)

    def write(self, gaussians: Gaussians, path: Path, seconds: int) -> None:
        """Write the film."""
        height, width = (side // 2 * 2 for side in self.cameras.size)
        write_video(self._render(gaussians, self.path(seconds * FPS).resized((height, width))), path, fps=FPS)

    def left_of(
        self, means: Float[Tensor, "1 N 3"], camera: viser.CameraHandle, share_of_width: float
    ) -> Bool[Tensor, "1 N"]:
        """Which Gaussians a browser shows left of a share of its width."""
        pose = pose_of(camera).to(means)
        seen = (means - pose[:3, 3]) @ pose[:3, :3]  # 1 N 3
        half = math.tan(camera.fov / 2) * camera.aspect
        return seen[..., 0] < (2 * share_of_width - 1) * half * seen[..., 2]


def pose_of(camera: viser.CameraHandle) -> Float[Tensor, "4 4"]:
    """World from camera, in OpenCV's axes, of where a browser looks from."""
    pose = torch.eye(4)
    pose[:3, :3] = matrix_from_wxyz(torch.from_numpy(np.array(camera.wxyz, np.float32)))
    pose[:3, 3] = torch.from_numpy(np.array(camera.position, np.float32))
    return pose
