"""What one browser shows of a scene: before, after or both, and the cameras of the photographs."""

import threading
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
import viser
from jaxtyping import Float, Float32
from torch import Tensor

from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.rotations import matrix_from_wxyz, wxyz_from_matrix
from anystyle.io.sheet import to_pil
from anystyle.types import Gaussians
from anystyle.viewer.flight import Flight
from anystyle.viewer.session import OpenScene

Array = np.ndarray
REST_SECONDS = 0.15
"""A split follows a camera that has rested for so long."""


class Drawn(NamedTuple):
    """Gaussians as viser draws them, in a unit in which the scene is 10 away: it keeps covariances in halves."""

    centers: Float32[Array, "N 3"]
    covariances: Float32[Array, "N 3 3"]
    rgbs: Float32[Array, "N 3"]
    opacities: Float32[Array, "N 1"]

    def where(self, chosen: Array) -> "Drawn":
        """Those that a mask chooses."""
        return Drawn(*(values[chosen] for values in self))


def drawn(gaussians: Gaussians, flight: Flight) -> Drawn:
    """The first scene of a batch, widened by the low-pass filter that the photographs' size asks for."""
    larger = 10 / flight.distance
    widened = flight.pixel_variances(gaussians.means[0])[:, None, None] * torch.eye(3, device=gaussians.means.device)
    return Drawn(
        centers=(gaussians.means[0] * larger).cpu().numpy(),
        covariances=((covariances(gaussians) + widened) * larger**2).cpu().numpy(),
        rgbs=rgb_from_constant(gaussians.harmonics[0, :, 0]).clamp(0, 1).cpu().numpy(),
        opacities=gaussians.opacities[0, :, None].cpu().numpy(),
    )


def covariances(gaussians: Gaussians) -> Float[Tensor, "N 3 3"]:
    """Of the first scene of a batch, in its units squared."""
    rotations = matrix_from_wxyz(torch.nn.functional.normalize(gaussians.rotations[0], dim=-1))
    turned = rotations * gaussians.scales[0, :, None]
    return turned @ turned.mT


class Look:
    """One browser: its share of the scene, and the folder of its panel that says which.

    Args:
        client: The browser.
        scene: What is looked at.
        flight: Knows its distance and cameras.
        before: The unstyled scene.
        order: Of the folder in the panel.
    """

    def __init__(
        self, client: viser.ClientHandle, scene: OpenScene, flight: Flight, before: Drawn, *, order: int
    ) -> None:
        self.client, self.scene, self.flight = client, scene, flight
        self._before = self._after = before
        self._splats: viser.GaussianSplatHandle | None = None
        self._lock, self._rest = threading.Lock(), threading.Timer(0, self.refresh)
        with client.gui.add_folder("Look", order=order):
            self.unstyled = client.gui.add_checkbox("Unstyled", False)
            self.split = client.gui.add_slider(
                "Before | after", 0.0, 1.0, 0.01, 0.0, hint="Left of the line is the scene without style"
            )
            self.line = client.gui.add_html("")
            self.cameras = client.gui.add_checkbox("Cameras", True)
        self._add_cameras()
        self.unstyled.on_update(lambda event: event.client and self.refresh())
        self.split.on_update(lambda event: event.client and self.refresh())
        self.cameras.on_update(lambda event: event.client and self.show_cameras(self.cameras.value))
        client.camera.on_update(lambda _: self._moved())

    def show(self, after: Drawn, *, styled: bool) -> None:
        """Show another scene.

        Args:
            after: The scene.
            styled: Whether it is another style than before, which nobody wants hidden.
        """
        self._after = after
        if styled:
            self.unstyled.value = False
        self.refresh()

    def refresh(self) -> None:
        """Show what is asked for."""
        with self._lock:
            splitting = self.split.value > 0 and not self.unstyled.value
            self.line.content = f'<i data-split="{self.split.value:g}"></i>' if splitting else ""
            values = self._parted() if splitting else self._before if self.unstyled.value else self._after
            if self._splats is None:
                scale = self.flight.distance / 10
                self._splats = self.client.scene.add_gaussian_splats("/scene", **values._asdict(), scale=scale)
            else:
                self._splats.set_gaussians(**values._asdict())

    def close(self) -> None:
        """Follow the camera no longer."""
        self._rest.cancel()

    def _parted(self) -> Drawn:
        """The unstyled scene left of the line, the styled one right of it, as the camera stands."""
        parts = []
        for side, values in enumerate((self._before, self._after)):
            means = torch.from_numpy(values.centers) * (self.flight.distance / 10)
            left = self.flight.left_of(means, self.client.camera, self.split.value).numpy()
            parts.append(values.where(~left if side else left))
        return Drawn(*map(np.concatenate, zip(*parts, strict=True)))

    def _moved(self) -> None:
        if self.split.value > 0:
            self._rest.cancel()
            self._rest = threading.Timer(REST_SECONDS, self.refresh)
            self._rest.daemon = True
            self._rest.start()

    def _add_cameras(self) -> None:
        """Frusta with their pictures; a click goes there, and hides them: one looks from where their pictures are."""
        self._frusta: list[viser.CameraFrustumHandle] = []
        height, width = self.scene.cameras.size
        for view, name in enumerate(self.scene.names):
            pose = self.scene.cameras.world_from_camera[0, view].cpu()
            picture = to_pil(self.scene.pictures[view]).resize((160, max(1, round(160 * height / width))))
            frustum = self.client.scene.add_camera_frustum(
                f"/cameras/{view:03d} {name}",
                fov=self.flight.field_of_view,
                aspect=width / height,
                scale=self.flight.distance / 60,
                thickness=1.0,
                thickness_units="screen",
                image=np.asarray(picture),
                wxyz=wxyz_from_matrix(pose[:3, :3]).double().numpy(),
                position=pose[:3, 3].double().numpy(),
            )
            frustum.on_click(partial(self._go_to, view))
            self._frusta.append(frustum)

    def _go_to(self, view: int, _: viser.SceneNodePointerEvent[viser.CameraFrustumHandle]) -> None:
        self.show_cameras(False)
        self.flight.look_from(self.client, self.scene.cameras.world_from_camera[0, view].cpu().double().numpy())

    def show_cameras(self, visible: bool) -> None:
        """Show or hide the frusta."""
        self.cameras.value = visible
        for frustum in self._frusta:
            frustum.visible = visible
