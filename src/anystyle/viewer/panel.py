"""The viewer's page: a scene, its cameras, and what one may ask for, in every browser that looks."""

import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.data.images import open_image
from anystyle.errors import one_line
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.rotations import matrix_from_wxyz, wxyz_from_matrix
from anystyle.inference.controls import blended
from anystyle.inference.export import FORMATS, export
from anystyle.inference.page import write_page
from anystyle.io.sheet import to_pil
from anystyle.types import Gaussians
from anystyle.viewer.flight import Flight
from anystyle.viewer.scenes import OpenScene
from anystyle.viewer.session import Session, Wish

try:
    import viser
except ImportError:
    raise ImportError('anystyle view needs viser; pip install "anystyle[viewer]"') from None

LARGEST_PICTURE = 32 * 1024 * 1024
NONE = "—"


class Panel:
    """Binds one session to a server of viser.

    Args:
        server: At a loopback address.
        scene: What is looked at.
        session: What may be asked.
        inputs: What was opened, as a command line names it.
        uploads: Where pictures that people give are kept.
        flight: The path of a camera.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: OpenScene,
        session: Session,
        *,
        inputs: str,
        uploads: Path,
        flight: Flight,
    ) -> None:
        self.server, self.scene, self.session = server, scene, session
        self.inputs, self.uploads, self.flight = inputs, uploads, flight
        self._lock = threading.Lock()
        self.asked = session.shown.style
        self._splats: viser.GaussianSplatHandle | None = None
        self._begin()
        self._add_cameras()
        self._add_style()
        self._add_look()
        self._add_path()
        self._add_files()
        session.on_change = self.refresh
        self.refresh()

    def _begin(self) -> None:
        """Axes and the first camera."""
        self.server.gui.configure_theme(control_width="medium", show_share_button=False, show_logo=False)
        self.server.scene.set_up_direction((0.0, -1.0, 0.0))
        pose = self.scene.cameras.world_from_camera[0, 0].cpu().double().numpy()
        camera = self.server.initial_camera
        # Behind the first camera, so that it is seen, and no picture of a frustum hides the scene.
        camera.position, camera.up = pose[:3, 3] - pose[:3, 2] * self.flight.distance / 4, -pose[:3, 1]
        camera.look_at = pose[:3, 3] + pose[:3, 2] * self.flight.distance
        camera.fov = self.flight.field_of_view
        camera.near = self.flight.distance / 1000

    def _add_cameras(self) -> None:
        """Frusta with their pictures; a click goes there, and hides them: one looks from where their pictures are."""
        self._frusta: list[viser.CameraFrustumHandle] = []
        height, width = self.scene.cameras.size
        for view, name in enumerate(self.scene.names):
            pose = self.scene.cameras.world_from_camera[0, view].cpu()
            frustum = self.server.scene.add_camera_frustum(
                f"/cameras/{view:03d} {name}",
                fov=self.flight.field_of_view,
                aspect=width / height,
                scale=self.flight.distance / 40,
                thickness=1.0,
                thickness_units="screen",
                image=np.asarray(to_pil(self.scene.pictures[view]).resize((160, max(1, round(160 * height / width))))),
                wxyz=wxyz_from_matrix(pose[:3, :3]).double().numpy(),
                position=pose[:3, 3].double().numpy(),
            )
            frustum.on_click(partial(self._go_to, view))
            self._frusta.append(frustum)

    def _go_to(self, view: int, event: viser.SceneNodePointerEvent[viser.CameraFrustumHandle]) -> None:
        pose = self.scene.cameras.world_from_camera[0, view].cpu().double().numpy()
        self._show_cameras(False)
        with event.client.atomic():
            event.client.camera.position = pose[:3, 3]
            event.client.camera.look_at = pose[:3, 3] + pose[:3, 2] * self.flight.distance
            event.client.camera.up_direction = -pose[:3, 1]

    def _add_style(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Style"):
            with gui.add_form(None) as form:
                self.text = gui.add_text("Text", "", hint="What the scene should look like; Enter paints it")
            paint = gui.add_button("Paint", icon=viser.Icon.BRUSH)
            self.upload = gui.add_upload_button("Upload a picture", mime_type="image/*", icon=viser.Icon.UPLOAD)
            self.recent = gui.add_dropdown("Recent", (NONE,), hint="Styles that were asked for; going back is instant")
            self.second = gui.add_dropdown("Towards", (NONE,), hint="A second style to mix in")
            self.amount = gui.add_slider("Amount", 0.0, 1.0, 0.05, 0.5, hint="0 is the first style, 1 the second")
            self.strength = gui.add_slider("Strength", 0.0, 1.0, 0.05, 1.0)
            self.preserve = gui.add_checkbox("Preserve colour", False, hint="The style's strokes in the scene's hues")
            self.status = gui.add_markdown("")
        paint.on_click(lambda _: form.submit())
        form.on_submit(lambda _: self._ask(self.text.value.strip()))
        self.upload.on_upload(self._take_picture)
        self.recent.on_update(lambda event: event.client and self._ask(self._path(self.recent.value)))
        for control in (self.second, self.amount, self.strength, self.preserve):
            # What the program itself sets has no client.
            control.on_update(lambda event: event.client and self._ask(self.asked))

    def _add_look(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Look"):
            self.unstyled = gui.add_checkbox("Unstyled", False)
            self.split = gui.add_slider(
                "Before | after", 0.0, 1.0, 0.01, 0.0, hint="Left of here, as you look now, is the scene without style"
            )
            self.cameras = gui.add_checkbox("Cameras", True)
        self.unstyled.on_update(lambda event: event.client and self.refresh())
        self.split.on_update(lambda event: event.client and self.refresh(event.client))
        self.cameras.on_update(lambda event: event.client and self._show_cameras(self.cameras.value))

    def _show_cameras(self, visible: bool) -> None:
        self.cameras.value = visible
        for frustum in self._frusta:
            frustum.visible = visible

    def _add_path(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Camera path", expand_by_default=False):
            add, clear = gui.add_button("Add keyframe"), gui.add_button("Clear")
            self.keys = gui.add_markdown("No keyframes: the path goes through the photographs.")
            self.seconds = gui.add_slider("Seconds", 1, 20, 1, 4)
            preview, render = gui.add_button("Preview"), gui.add_button("Render MP4")
        add.on_click(lambda event: self._keyframe(event.client))
        clear.on_click(lambda _: self._keyframe(None))
        preview.on_click(lambda event: event.client and self.flight.preview(event.client, self.seconds.value))
        render.on_click(lambda event: event.client and self._download(event.client, "video.mp4", self._write_video))

    def _keyframe(self, client: viser.ClientHandle | None) -> None:
        count = self.flight.add(client.camera) if client else self.flight.clear()
        self.keys.content = f"{count} keyframes." if count else "No keyframes: the path goes through the photographs."

    def _add_files(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Save", expand_by_default=False):
            self.format = gui.add_dropdown("Format", (*FORMATS, "html"))
            save = gui.add_button("Download", icon=viser.Icon.DOWNLOAD)
            gui.add_markdown("The command line of what is shown:")
            self.command = gui.add_markdown("")

        @save.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is not None:
                self._download(event.client, f"scene.{self.format.value}", self._write_scene)

    def _path(self, name: str) -> str:
        """A recent style by the name in its list."""
        return next((style for style in self._styles() if _name(style) == name), "")

    def _styles(self) -> list[str]:
        return [*self.session.recent, *(style for style in self.session.saved if style not in self.session.recent)]

    def _ask(self, style: str) -> None:
        self.asked = style
        second = "" if self.second.value == NONE else self._path(self.second.value)
        self.unstyled.value = False
        self.session.ask(
            Wish(
                style=style,
                second=second if style and second != style else "",
                amount=self.amount.value if second and second != style else 0.5,
                strength=self.strength.value,
                preserve_color=float(self.preserve.value),
            )
        )

    def _take_picture(self, event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
        """A picture from a browser: kept as PNG once it has been decoded safely."""
        given = self.upload.value
        try:
            if len(given.content) > LARGEST_PICTURE:
                raise ValueError(f"a picture of {len(given.content):,} bytes; at most {LARGEST_PICTURE:,} are taken")
            stem = "".join(letter if letter.isalnum() else "-" for letter in Path(given.name).stem)[:40] or "picture"
            self.uploads.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=self.uploads, prefix=".given-") as file:
                file.write(given.content)
                file.flush()
                picture = open_image(Path(file.name), longest=2048)
        except (ValueError, OSError) as error:
            self._say(one_line(error).replace(".given-", "the picture "))
            return
        target = self.uploads / f"{stem}.png"
        picture.save(target)
        self._ask(str(target))

    def _say(self, text: str) -> None:
        self.status.content = text

    def refresh(self, client: viser.ClientHandle | None = None) -> None:
        """Show what the session holds now, in every browser."""
        with self._lock:
            shown = self.session.shown
            gaussians = self.scene.unstyled if self.unstyled.value else self.session.gaussians
            client = client or next(iter(self.server.get_clients().values()), None)
            if self.split.value > 0 and client is not None and not self.unstyled.value:
                left = self.flight.left_of(gaussians.means, client.camera, self.split.value)
                gaussians = blended(self.scene.unstyled, gaussians, (~left).float())
            self._show(gaussians)
            names = [_name(style) for style in self._styles()]
            for dropdown, value in ((self.recent, _name(shown.style)), (self.second, self.second.value)):
                if dropdown.options != (NONE, *names):
                    dropdown.options = (NONE, *names)
                if dropdown.value != (value if value in names else NONE):
                    dropdown.value = value if value in names else NONE
            self._say(self.session.status or f"Shown: {_name(shown.style) or 'the scene itself'}")
            self.command.content = f"```\n{shown.command(self.inputs)}\n```"

    def _show(self, gaussians: Gaussians) -> None:
        # The page keeps covariances in half precision, which small scenes fall below: they are enlarged on the way.
        enlarged = 10 / self.flight.distance
        blur = self.flight.pixel_variances(gaussians.means[0])[:, None, None] * torch.eye(
            3, device=gaussians.means.device
        )
        values = {
            "centers": gaussians.means[0].cpu().numpy() * enlarged,
            "covariances": (covariances(gaussians) + blur).cpu().numpy() * enlarged**2,
            "rgbs": rgb_from_constant(gaussians.harmonics[0, :, 0]).clamp(0, 1).cpu().numpy(),
            "opacities": gaussians.opacities[0, :, None].cpu().numpy(),
        }
        if self._splats is None:
            self._splats = self.server.scene.add_gaussian_splats("/scene", **values, scale=1 / enlarged)
        else:
            self._splats.set_gaussians(**values)

    def _download(self, client: viser.ClientHandle, name: str, write: Callable[[Path], None]) -> None:
        note = client.add_notification(f"Writing {name}", "", loading=True)
        try:
            with tempfile.TemporaryDirectory() as folder:
                write(Path(folder) / name)
                client.send_file_download(name, (Path(folder) / name).read_bytes())
        except (ValueError, OSError) as error:
            self._say(one_line(error))
        finally:
            note.remove()

    def _write_scene(self, path: Path) -> None:
        name = path.suffix[1:]
        if name != "html":
            return export(self.session.gaussians, path, name)
        title = _name(self.session.shown.style) or "the scene"
        styles = [("unstyled", self.scene.unstyled), (title, self.session.gaussians)]
        return write_page(path, styles if self.session.shown.style else styles[:1], self.scene.cameras, title=title)

    def _write_video(self, path: Path) -> None:
        self.flight.write(self.session.gaussians, path, self.seconds.value)


def _name(style: str) -> str:
    return Path(style).stem if style and Path(style).suffix == ".png" else style[:60]


def covariances(gaussians: Gaussians) -> Float[Tensor, "N 3 3"]:
    """Of the first scene of a batch, in its units squared."""
    turned = (
        matrix_from_wxyz(torch.nn.functional.normalize(gaussians.rotations[0], dim=-1)) * gaussians.scales[0, :, None]
    )
    return turned @ turned.mT
