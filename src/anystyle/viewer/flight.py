"""A camera's flight: keyframes from a browser, a preview in it, and a film."""

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

from anystyle.documents import kept_json
from anystyle.geometry.cameras import smooth_path
from anystyle.geometry.rotations import matrix_from_wxyz
from anystyle.io.atomic import write_json
from anystyle.io.video import write_video
from anystyle.types import Cameras, Gaussians

FPS, PREVIEW_FPS = 30, 15

_Row = tuple[float, float, float, float]
_Pose = tuple[_Row, _Row, _Row, _Row]

Render = Callable[[Gaussians, Cameras], Iterator[Float[Tensor, "3 H W"]]]


class Flight:
    """Keyframes and what is made of them.

    Args:
        cameras: Of the photographs; the path goes through them while there are no keyframes.
        unstyled: The scene, for its distance.
        render: Renders cameras one by one.
        file: Where keyframes are kept; ``None`` forgets them.
    """

    def __init__(self, cameras: Cameras, unstyled: Gaussians, render: Render, file: Path | None = None) -> None:
        self.cameras, self.render, self._file = cameras.to("cpu"), render, file
        kept = kept_json(file, list[_Pose]) if file is not None else None
        self._keys: list[Float[Tensor, "4 4"]] = [torch.tensor(pose) for pose in kept or ()]
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

    def __len__(self) -> int:
        """How many keyframes there are."""
        return len(self._keys)

    def add(self, camera: viser.CameraHandle) -> None:
        """Keep where a browser looks from."""
        self._keys.append(pose_of(camera))
        self._keep()

    def clear(self) -> None:
        """Forget all keyframes."""
        self._keys.clear()
        self._keep()

    def _keep(self) -> None:
        if self._file is not None:
            write_json(self._file, [pose.tolist() for pose in self._keys])

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
            self.look_from(client, pose)
            time.sleep(1 / PREVIEW_FPS)

    def look_from(self, client: viser.ClientHandle, pose: Float64[np.ndarray, "4 4"]) -> None:
        """Put a browser's camera somewhere, world from camera in OpenCV's axes."""
        with client.atomic():
            client.camera.position = pose[:3, 3]
            client.camera.up_direction = -pose[:3, 1]
            client.camera.look_at = pose[:3, 3] + pose[:3, 2] * self.distance
        client.flush()

    def write(
        self, gaussians: Gaussians, path: Path, seconds: int, on_frame: Callable[[int, int], None] = lambda _, __: None
    ) -> None:
        """Write the film, in the size of the photographs.

        Args:
            gaussians: The scene.
            path: The file.
            seconds: How long it is.
            on_frame: Told which frame of how many is done.
        """
        height, width = (side // 2 * 2 for side in self.cameras.size)
        frames = self.render(gaussians, self.path(seconds * FPS).resized((height, width)))
        write_video(_counted(frames, seconds * FPS, on_frame), path, fps=FPS)

    def small_picture(self, gaussians: Gaussians, height: int) -> Float[Tensor, "3 _ _"]:
        """The scene from the first camera, sRGB in [0, 1]."""
        width = round(self.cameras.size[1] * height / self.cameras.size[0])
        return next(self.render(gaussians, self.cameras.select([0]).resized((height, width))))

    def left_of(
        self, means: Float[Tensor, "*batch 3"], camera: viser.CameraHandle, share_of_width: float
    ) -> Bool[Tensor, "*batch"]:
        """Which Gaussians a browser shows left of a share of its width."""
        pose = pose_of(camera).to(means)
        seen = (means - pose[:3, 3]) @ pose[:3, :3]
        half = math.tan(camera.fov / 2) * camera.aspect
        return seen[..., 0] < (2 * share_of_width - 1) * half * seen[..., 2]


def _counted(
    frames: Iterator[Float[Tensor, "3 H W"]], total: int, on_frame: Callable[[int, int], None]
) -> Iterator[Float[Tensor, "3 H W"]]:
    for index, frame in enumerate(frames, 1):
        yield frame
        on_frame(index, total)


def pose_of(camera: viser.CameraHandle) -> Float[Tensor, "4 4"]:
    """World from camera, in OpenCV's axes, of where a browser looks from."""
    pose = torch.eye(4)
    pose[:3, :3] = matrix_from_wxyz(torch.from_numpy(np.array(camera.wxyz, np.float32)))
    pose[:3, 3] = torch.from_numpy(np.array(camera.position, np.float32))
    return pose
