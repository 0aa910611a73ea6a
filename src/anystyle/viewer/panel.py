"""The viewer's page: a scene and what one may ask for. The style is everybody's; how each looks at it is his own."""

import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import viser

from anystyle.errors import one_line
from anystyle.inference.export import FORMATS, export, write_page
from anystyle.io.sheet import to_pil
from anystyle.types import Gaussians
from anystyle.viewer.flight import Flight
from anystyle.viewer.look import Look, drawn
from anystyle.viewer.page import address, keep_picture, name_of, row
from anystyle.viewer.session import OpenScene, Session, Wish

NONE = "—"
THUMBNAIL = 72
"""Pixels that the picture of a style is high."""


class Panel:
    """Binds one session to a server of viser.

    Args:
        server: At a loopback address.
        scene: What is looked at.
        session: What may be asked.
        flight: The path of a camera.
        folder: Where pictures that people give are kept.
        command: What was opened and the words it was opened with, as a command line has them.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: OpenScene,
        session: Session,
        flight: Flight,
        *,
        folder: Path,
        command: tuple[str, Sequence[str]],
    ) -> None:
        self.server, self.scene, self.session, self.flight = server, scene, session, flight
        self._folder, self._opened = folder, command
        self._lock = threading.Lock()
        self._looks: dict[int, Look] = {}
        self._pictures: dict[str, str] = {}
        self.asked = session.shown.style
        self._before = self._after = drawn(scene.unstyled, flight)
        self._shown: Wish | None = None
        self._begin()
        self._add_style()
        self._add_path()
        self._add_files()
        session.on_change, session.on_status = self._changed, self._tell
        self._changed()
        threading.Thread(target=self._draw_saved, daemon=True).start()
        server.on_client_connect(self._join)
        server.on_client_disconnect(self._leave)

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

    def _join(self, client: viser.ClientHandle) -> None:
        with self._lock:
            look = Look(client, self.scene, self.flight, self._before, order=2)
            self._looks[client.client_id] = look
            look.show(self._after, styled=False)

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            if look := self._looks.pop(client.client_id, None):
                look.close()

    def _add_style(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Style", order=1):
            with gui.add_form(None) as form:
                self.text = gui.add_text("Text", "", hint="What the scene should look like; Enter paints it")
            paint = gui.add_button("Paint", icon=viser.Icon.BRUSH)
            self.upload = gui.add_upload_button(
                "Upload or drop a picture", mime_type="image/*", icon=viser.Icon.UPLOAD, hint="Drop it anywhere"
            )
            self.progress = gui.add_progress_bar(0, visible=False, animated=True)
            self.status = gui.add_markdown("")
            self.row = gui.add_html("")
            self.second = gui.add_dropdown("Towards", [NONE], hint="A second style to mix in")
            self.amount = gui.add_slider("Amount", 0.0, 1.0, 0.05, 0.5, hint="0 is the first style, 1 the second")
            self.strength = gui.add_slider("Strength", 0.0, 1.0, 0.05, 1.0)
            self.preserve = gui.add_checkbox("Preserve colour", False, hint="The style's strokes in the scene's hues")
        paint.on_click(lambda _: form.submit())
        form.on_submit(lambda _: self.ask(self.text.value.strip()))
        self.upload.on_upload(lambda event: self._take(event.target.value.name, event.target.value.content))
        for control in (self.second, self.amount, self.strength, self.preserve):
            # What the program itself sets has no client.
            control.on_update(lambda event: event.client and self.ask(self.asked))

    def _add_path(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Camera path", expand_by_default=False, order=3):
            add, clear = gui.add_button("Add keyframe"), gui.add_button("Clear")
            self.keys = gui.add_markdown("")
            self.seconds = gui.add_slider("Seconds", 1, 20, 1, 4)
            preview, render = gui.add_button("Preview"), gui.add_button("Render MP4")
        self._count_keys()
        add.on_click(lambda event: event.client and self._keyframe(event.client))
        clear.on_click(lambda _: self._keyframe(None))
        preview.on_click(lambda event: event.client and self.flight.preview(event.client, self.seconds.value))
        render.on_click(lambda event: event.client and self._download(event.client, "video.mp4", self._write_video))

    def _keyframe(self, client: viser.ClientHandle | None) -> None:
        if client is None:
            self.flight.clear()
        else:
            self.flight.add(client.camera)
        self._count_keys()

    def _count_keys(self) -> None:
        count = len(self.flight)
        number = f"{count} keyframe{'s' * (count > 1)}." if count else ""
        self.keys.content = number or "No keyframes: the path goes through the photographs."

    def _add_files(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Save", expand_by_default=False, order=4):
            self.format = gui.add_dropdown("Format", (*FORMATS, "html"))
            save = gui.add_button("Download", icon=viser.Icon.DOWNLOAD)
            gui.add_markdown("The command line of what is shown:")
            self.command = gui.add_markdown("")

        @save.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is not None:
                name = self.format.value
                self._download(event.client, f"scene.{name}", lambda path, _: self._write_scene(path, name))

    def ask(self, style: str) -> None:
        """Ask for a style as the controls stand."""
        self.asked = style
        second = next((one for one in self.session.styles() if name_of(one) == self.second.value), "")
        mixed = bool(style and second and second != style)
        self.session.ask(
            Wish(
                style=style,
                second=second if mixed else "",
                amount=self.amount.value if mixed else 0.5,
                strength=self.strength.value,
                preserve_color=float(self.preserve.value),
            )
        )

    def ask_picture(self, name: str, content: bytes) -> None:
        """Ask for the style of a picture.

        Raises:
            ValueError: It is none.
        """
        self.ask(str(keep_picture(self._folder, name, content)))

    def _take(self, name: str, content: bytes) -> None:
        try:
            self.ask_picture(name, content)
        except (ValueError, OSError) as error:
            self.status.content = one_line(error)

    def _tell(self) -> None:
        """Show in every browser what is being done."""
        painting, done = self.session.painting, self.session.done
        self.progress.visible = painting is not None
        self.progress.animated = done is None
        self.progress.value = 100.0 if done is None else 100 * done
        if painting is not None:
            self.status.content = f"{name_of(painting.style)}: {self.session.status} …"
        else:
            shown = " → ".join(name_of(style) for style in self.session.shown.styles) or "unstyled"
            self.status.content = self.session.status or f"Shown: {shown}"

    def _changed(self) -> None:
        """Show in every browser what the session holds now."""
        with self._lock:
            wish, gaussians = self.session.shown, self.session.gaussians
            styled = self._shown is not None and wish != self._shown
            self._shown = wish
            self._after = drawn(gaussians, self.flight)
            for look in self._looks.values():
                look.show(self._after, styled=styled)
        self._tell()
        self.command.content = f"```\n{self.session.command(*self._opened)}\n```"
        if wish == Wish(wish.style) or wish.style not in self._pictures:
            self._draw(wish.style, gaussians)
        self._show_row()
        names = (NONE, *(name_of(style) for style in self.session.styles()))
        if self.second.options != names:
            self.second.options = names

    def _draw_saved(self) -> None:
        """Pictures of the styles that were there before."""
        for style, gaussians in self.session.saved.items():
            self._draw(style, gaussians)

    def _draw(self, style: str, gaussians: Gaussians) -> None:
        self._pictures[style] = address(to_pil(self.flight.small_picture(gaussians, THUMBNAIL)))
        self._show_row()

    def _show_row(self) -> None:
        self.row.content = row(["", *self.session.styles()], self.session.shown.style, dict(self._pictures))

    def _download(
        self, client: viser.ClientHandle, name: str, write: Callable[[Path, Callable[[int, int], None]], None]
    ) -> None:
        """Write a file, and give it to one browser."""
        note = client.add_notification(f"Writing {name}", "", loading=True)

        def tell(done: int, total: int) -> None:
            note.body = f"{done} of {total} frames"

        try:
            with tempfile.TemporaryDirectory() as folder:
                write(Path(folder) / name, tell)
                client.send_file_download(name, (Path(folder) / name).read_bytes(), save_immediately=True)
        except (ValueError, OSError) as error:
            client.add_notification(f"{name} is not written", one_line(error), color="red")
        finally:
            note.remove()

    def _write_scene(self, path: Path, name: str) -> None:
        session, title = self.session, name_of(self.session.shown.style) or "unstyled"
        notes = "\n".join(self.scene.notes)
        if name == "html":
            styles = {"unstyled": self.scene.unstyled, **session.kept(), title: session.gaussians}
            styles[title] = styles.pop(title)  # the last one is shown at first
            write_page(path, list(styles.items()), self.scene.cameras, title=Path(self._opened[0]).stem, notes=notes)
        else:
            export(session.gaussians, path, name, notes="\n".join(filter(None, (title, notes))))

    def _write_video(self, path: Path, on_frame: Callable[[int, int], None]) -> None:
        self.flight.write(self.session.gaussians, path, self.seconds.value, on_frame)
