"""What one browser shows: the scene with or without style or both side by side, and the cameras of the photographs."""

import threading
from functools import partial
from typing import Any

import numpy as np
import torch
import viser

from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.projection import covariances
from anystyle.geometry.transforms import wxyz_from_matrix
from anystyle.io.sheet import to_pil
from anystyle.pipeline.encode import EncodedCapture
from anystyle.types import Gaussians
from anystyle_viewer.camera_path import CameraPath, left_of

SPLIT_DELAY = 0.15
"""Seconds after a camera's last movement when a split view is cut anew."""
VISER_DISTANCE = 10.0
"""Scenes are sent at a scale at which they are this far away: viser stores covariances in half precision."""
LOW_PASS = 0.3
"""Variance in pixels² that renderers add to a Gaussian in the image; here, pixels are those of the first camera.

A browser's window has more pixels than a photograph: without it, there would be gaps between Gaussians.
"""


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
            self.cameras = client.gui.add_checkbox("Cameras", True)
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
            image = to_pil(photograph).resize((160, max(1, round(160 * height / width))))
            frustum = self.client.scene.add_camera_frustum(
                f"/cameras/{len(self._frusta):03d} {name}",
                fov=self.path.field_of_view,
                aspect=width / height,
                scale=self.path.distance / 60,
                thickness=1.0,
                thickness_units="screen",
                image=np.asarray(image),
                wxyz=wxyz_from_matrix(pose[:3, :3]).double().numpy(),
                position=pose[:3, 3].double().numpy(),
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
