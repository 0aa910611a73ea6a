"""A camera path: keyframes from a browser's camera, a preview there, and a video."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import viser
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from anystyle.geometry.cameras import smooth_path
from anystyle.geometry.transforms import matrix_from_wxyz
from anystyle.io.video import write_video
from anystyle.pipeline.encode import EncodedCapture
from anystyle.types import Cameras, Gaussians

FPS, PREVIEW_FPS = 30, 15


class CameraPath:
    """Keyframes, and the smooth path through them; without keyframes it goes through the cameras of the photographs."""

    def __init__(self, encoded: EncodedCapture, unstyled: Gaussians) -> None:
        self.cameras, self._render = encoded.cameras.to("cpu"), encoded.render
        self.keyframes: list[Float[Tensor, "4 4"]] = []
        pose = encoded.cameras.camera_from_world[0, 0].to(unstyled.means)
        depth = (unstyled.means[0] @ pose[:3, :3].mT + pose[:3, 3])[:, 2]
        self.distance = float(depth[depth > 0].median()) if bool((depth > 0).any()) else 1.0
        """From the first camera to the scene: the median depth."""
        self.field_of_view = 2 * math.atan(self.cameras.size[0] / 2 / float(self.cameras.intrinsics[0, 0, 1, 1]))
        """Vertical, of the first camera, in radians."""

    def preview(self, client: viser.ClientHandle, seconds: int) -> None:
        """Move a browser's camera along the path."""
        for pose in smooth_path(self._knots(), seconds * PREVIEW_FPS).world_from_camera[0].double().numpy():
            self.look_from(client, pose)
            time.sleep(1 / PREVIEW_FPS)

    def look_from(self, client: viser.ClientHandle, pose: Float64[np.ndarray, "4 4"]) -> None:
        """Set a browser's camera to a pose, world from camera in OpenCV's axes."""
        with client.atomic():
            client.camera.position = pose[:3, 3]
            client.camera.up_direction = -pose[:3, 1]
            client.camera.look_at = pose[:3, 3] + pose[:3, 2] * self.distance
        client.flush()

    def write_video(self, gaussians: Gaussians, path: Path, seconds: int, on_frame: Callable[[int, int], None]) -> None:
        """Render the path as a video of the size of the photographs; ``on_frame`` takes frames done and in all."""
        height, width = (side // 2 * 2 for side in self.cameras.size)
        total = seconds * FPS

        def frames() -> Iterator[Float[Tensor, "3 H W"]]:
            cameras = smooth_path(self._knots(), total).resized((height, width))
            for index, frame in enumerate(self._render(gaussians, cameras), 1):
                yield frame
                on_frame(index, total)

        write_video(frames(), path, fps=FPS)

    def _knots(self) -> Cameras:
        if not self.keyframes:
            return self.cameras
        intrinsics = self.cameras.intrinsics[:, :1].expand(1, len(self.keyframes), 3, 3)
        return replace(self.cameras, world_from_camera=torch.stack(self.keyframes)[None], intrinsics=intrinsics)

    def thumbnail(self, gaussians: Gaussians, height: int) -> Float[Tensor, "3 _ _"]:
        """The scene from the first camera, sRGB in [0, 1]."""
        width = round(self.cameras.size[1] * height / self.cameras.size[0])
        return next(self._render(gaussians, self.cameras.select([0]).resized((height, width))))


def pose_of(camera: viser.CameraHandle) -> Float[Tensor, "4 4"]:
    """The pose of a browser's camera, world from camera in OpenCV's axes."""
    pose = torch.eye(4)
    pose[:3, :3] = matrix_from_wxyz(torch.from_numpy(np.array(camera.wxyz, np.float32)))
    pose[:3, 3] = torch.from_numpy(np.array(camera.position, np.float32))
    return pose


def left_of(means: Float[Tensor, "*batch 3"], camera: viser.CameraHandle, fraction: float) -> Bool[Tensor, "*batch"]:
    """Which points a browser shows left of a fraction of the window's width."""
    pose = pose_of(camera).to(means)
    local = (means - pose[:3, 3]) @ pose[:3, :3]
    half_width = math.tan(camera.fov / 2) * camera.aspect
    return local[..., 0] < (2 * fraction - 1) * half_width * local[..., 2]
