"""What one browser shows: the scene with or without style or both side by side, cameras, and the camera path."""

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import viser
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from anystyle.geometry.cameras import smooth_path
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.projection import covariances
from anystyle.geometry.transforms import matrix_from_wxyz, wxyz_from_matrix
from anystyle.io.sheet import to_pil
from anystyle.io.video import write_video
from anystyle.pipeline.encode import EncodedCapture
from anystyle.types import Cameras, Gaussians
from anystyle_formats.views import best_view

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
        self.opening = best_view(unstyled.means[0], unstyled.opacities[0], self.cameras)
        """The camera from which a browser looks at first."""

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
        """The scene as it is seen at first, sRGB in [0, 1]."""
        width = round(self.cameras.size[1] * height / self.cameras.size[0])
        return next(self._render(gaussians, self.cameras.select([self.opening]).resized((height, width))))


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


SPLIT_DELAY = 0.15
"""Seconds after a camera's last movement when a split view is cut anew."""
VISER_DISTANCE = 10.0
"""Scenes are sent at a scale at which they are this far away: viser stores covariances in half precision."""
LOW_PASS = 0.3
"""Variance that renderers add to a Gaussian, in the first camera's pixels²: without it, windows would show gaps."""
SplatArrays = dict[str, Any]
"""NumPy arrays: the arguments of viser's ``add_gaussian_splats``."""


def splat_arrays(gaussians: Gaussians, path: CameraPath) -> SplatArrays:
    """The first scene of a batch as viser draws it, at the scale of :data:`VISER_DISTANCE`."""
    scale = VISER_DISTANCE / path.distance
    means = gaussians.means[0]
    pose = path.cameras.camera_from_world[0, 0].to(means)
    depth = means @ pose[2, :3] + pose[2, 3]
    pixel = depth / path.cameras.intrinsics[0, 0, 0, 0].to(means)  # its size at that depth
    blur = LOW_PASS * pixel.square()[:, None, None] * torch.eye(3).to(means)
    tensors = {
        "centers": means * scale,
        "covariances": (covariances(gaussians.rotations[0], gaussians.scales[0]) + blur) * scale**2,
        "rgbs": rgb_from_constant(gaussians.harmonics[0, :, 0]).clamp(0, 1),
        "opacities": gaussians.opacities[0, :, None],
    }
    return {name: tensor.cpu().numpy() for name, tensor in tensors.items()}


class ClientView:
    """The view of one browser, and the folder of its panel that controls it."""

    def __init__(
        self, client: viser.ClientHandle, encoded: EncodedCapture, path: CameraPath, before: SplatArrays, *, order: int
    ) -> None:
        self.client, self.path = client, path
        self._before = self._after = before
        self._splats: viser.GaussianSplatHandle | None = None
        self._lock, self.timer = threading.Lock(), threading.Timer(0, self.refresh)
        with client.gui.add_folder("Look", order=order):
            self.unstyled = client.gui.add_checkbox("Unstyled", False)
            self.split = client.gui.add_slider(
                "Before | after", 0.0, 1.0, 0.01, 0.0, hint="Left of the line is the scene without style"
            )
            self.line = client.gui.add_html("")
            self.cameras = client.gui.add_checkbox("Cameras", False, hint="Click one to look from there")
        self._add_frusta(encoded)
        self.unstyled.on_update(lambda event: event.client and self.refresh())
        self.split.on_update(lambda event: event.client and self.refresh())
        self.cameras.on_update(lambda event: event.client and self.show_cameras(self.cameras.value))
        client.camera.on_update(lambda _: self._camera_moved())

    def show(self, after: SplatArrays, *, is_new: bool) -> None:
        """Show the scene in a style; a new one switches *Unstyled* off."""
        self._after = after
        if is_new:
            self.unstyled.value = False
        self.refresh()

    def refresh(self) -> None:
        """Send what the controls ask for."""
        with self._lock:
            splitting = self.split.value > 0 and not self.unstyled.value
            self.line.content = f'<i data-split="{self.split.value:g}"></i>' if splitting else ""  # for page.js
            arrays = self._split() if splitting else self._before if self.unstyled.value else self._after
            if self._splats is None:
                scale = self.path.distance / VISER_DISTANCE
                self._splats = self.client.scene.add_gaussian_splats("/scene", **arrays, scale=scale)
            else:
                self._splats.set_gaussians(**arrays)

    def _split(self) -> SplatArrays:
        """The unstyled scene left of the line, the styled one right of it, as seen from the current camera."""
        scale = self.path.distance / VISER_DISTANCE
        before, after = (
            left_of(torch.from_numpy(arrays["centers"]) * scale, self.client.camera, self.split.value).numpy()
            for arrays in (self._before, self._after)
        )
        return {name: np.concatenate([self._before[name][before], self._after[name][~after]]) for name in self._before}

    def _camera_moved(self) -> None:
        if self.split.value > 0:
            self.timer.cancel()
            self.timer = threading.Timer(SPLIT_DELAY, self.refresh)
            self.timer.daemon = True
            self.timer.start()

    def _add_frusta(self, encoded: EncodedCapture) -> None:
        """Add the cameras with their photographs; a click goes to one, and hides all, as they would cover the scene."""
        self._frusta: list[viser.CameraFrustumHandle] = []
        height, width = encoded.cameras.size
        poses = encoded.cameras.world_from_camera[0].cpu()
        for name, pose, photograph in zip(encoded.names, poses, encoded.views.images[0], strict=True):
            frustum = self.client.scene.add_camera_frustum(
                f"/cameras/{len(self._frusta):03d} {name}",
                fov=self.path.field_of_view,
                aspect=width / height,
                scale=self.path.distance / 60,
                thickness=1.0,
                thickness_units="screen",
                image=np.asarray(to_pil(photograph).resize((160, max(1, round(160 * height / width))))),
                wxyz=wxyz_from_matrix(pose[:3, :3]).double().numpy(),
                position=pose[:3, 3].double().numpy(),
                visible=False,
            )
            frustum.on_click(partial(self._go_to, pose.double().numpy()))
            self._frusta.append(frustum)

    def _go_to(self, pose: np.ndarray, _: viser.SceneNodePointerEvent[viser.CameraFrustumHandle]) -> None:
        self.show_cameras(False)
        self.path.look_from(self.client, pose)

    def show_cameras(self, visible: bool) -> None:
        """Show or hide the frusta."""
        self.cameras.value = visible
        for frustum in self._frusta:
            frustum.visible = visible
