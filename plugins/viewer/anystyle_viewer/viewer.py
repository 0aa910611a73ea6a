"""The viewer: a session on viser's page. The style is shared by all browsers; each has a view of its own."""

import contextlib
import io
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import viser
from torch import Tensor

from anystyle.errors import UserError, one_line
from anystyle.io.sheet import data_url, to_pil
from anystyle.pipeline.export import export_styles
from anystyle.pipeline.masks import Sphere
from anystyle.pipeline.saved import UNSTYLED
from anystyle.registry.catalog import catalog
from anystyle.types import Gaussians, StyledScene
from anystyle_viewer.client_view import CameraPath, ClientView, pose_of, splat_arrays
from anystyle_viewer.picking import Vector, surface_point
from anystyle_viewer.server import LOOPBACK, MAX_UPLOAD, PageServer, page, store_upload, style_row, title_of
from anystyle_viewer.session import Session, StyleRequest

NO_STYLE = "—"
THUMBNAIL_HEIGHT = 72

OnFrame = Callable[[int, int], None]


class Viewer(contextlib.AbstractContextManager["Viewer"]):
    """A running viewer; as a context manager it is closed at the end."""

    def __init__(self, session: Session, folder: Path, command: tuple[str, Sequence[str]], port: int = 0) -> None:
        self.session, self._folder, self._command_words = session, folder, command
        self.encoded, self.unstyled = session.restyler.encoded, session.restyler.unstyled
        self.path = CameraPath(self.encoded, self.unstyled)
        with contextlib.redirect_stdout(io.StringIO()):  # viser prints its own port
            self.viser = viser.ViserServer(LOOPBACK[0], 0, label="anystyle", verbose=False)
        self._lock = threading.Lock()
        self._views: dict[int, ClientView] = {}
        self._thumbnails: dict[str, str] = {}
        self._before = self._after = splat_arrays(self.unstyled, self.path)
        self._shown: StyleRequest | None = None
        self._set_first_camera()
        self._add_style_controls()
        self._add_place_controls()
        self._add_path_controls()
        self._add_save_controls()
        session.on_change, session.on_status = self._style_changed, self._show_status
        self._style_changed()
        self.viser.on_client_connect(self._connected)
        self.viser.on_client_disconnect(self._disconnected)
        self.server = PageServer(
            port=port,
            viser_port=self.viser.get_port(),
            page=page(Path(viser.__file__).parent / "client" / "build" / "index.html"),
            on_post={
                "/picture": lambda query, body: self.request(str(store_upload(folder, query.get("name", ""), body))),
                "/style": lambda _, body: self.request(body.decode("utf-8", errors="replace")),
                "/saved": lambda _, body: self._open(body.decode("utf-8", errors="replace")),
            },
            max_body=MAX_UPLOAD,
        )
        saved = [("", self.unstyled), *session.saved.items()]
        threading.Thread(target=lambda: [self._render_thumbnail(*one) for one in saved], daemon=True).start()

    def __exit__(self, *_: object) -> None:
        self.server.close()
        self.session.close()
        self.viser.stop()

    def _set_first_camera(self) -> None:
        self.viser.gui.configure_theme(control_width="medium", show_share_button=False, show_logo=False)
        self.viser.scene.set_up_direction((0.0, -1.0, 0.0))
        pose = self.path.cameras.world_from_camera[0, self.path.opening].double().numpy()
        camera = self.viser.initial_camera
        camera.position, camera.up = pose[:3, 3], -pose[:3, 1]
        camera.look_at = pose[:3, 3] + pose[:3, 2] * self.path.distance
        camera.fov = self.path.field_of_view
        camera.near = self.path.distance / 1000

    def _connected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            view = ClientView(client, self.encoded, self.path, self._before, order=2)
            self._views[client.client_id] = view
            view.show(self._after, is_new=False)

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            if view := self._views.pop(client.client_id, None):
                view.timer.cancel()

    def _add_style_controls(self) -> None:
        gui = self.viser.gui
        with gui.add_folder("Style", order=1):
            with gui.add_form(None) as form:
                self.text = gui.add_text("Text", "", hint="What the scene should look like; Enter paints it")
            paint = gui.add_button("Paint", icon=viser.Icon.BRUSH)
            upload = gui.add_upload_button(
                "Upload or drop a picture", mime_type="image/*", icon=viser.Icon.UPLOAD, hint="Drop it anywhere"
            )
            self.progress = gui.add_progress_bar(0, visible=False, animated=True)
            self.status = gui.add_markdown("")
            self.row = gui.add_html("")
            self.second = gui.add_dropdown("Towards", [NO_STYLE], hint="A second style to mix in")
            kept, in_hues = self.session.wanted, "The style's strokes in the scene's hues"
            self.amount = gui.add_slider(
                "Amount", 0.0, 1.0, 0.05, kept.amount, hint="0 is the first style, 1 the second"
            )
            self.strength = gui.add_slider("Strength", 0.0, 1.0, 0.05, kept.strength)
            self.preserve = gui.add_checkbox("Preserve colour", kept.preserve_color > 0, hint=in_hues)
        paint.on_click(lambda _: form.submit())
        form.on_submit(lambda _: self.request(self.text.value.strip()))
        upload.on_upload(lambda event: self._uploaded(event.target.value))
        for control in (self.second, self.amount, self.strength, self.preserve):
            # Values that the program sets come without a client.
            control.on_update(lambda event: event.client and self.request(self.session.wanted.style))

    def _add_place_controls(self) -> None:
        gui = self.viser.gui
        kept = None
        with contextlib.suppress(UserError):  # of a damaged file; the session says so
            kept = self.session.wanted.controls.mask
        near = kept if isinstance(kept, Sphere) else None
        self._point = near and near.center
        far = min(2.0, max(0.05, round(near.radius / self.path.distance, 2))) if near else 0.3
        with gui.add_folder("Place", expand_by_default=False, order=1.5):
            gui.add_markdown("Shift-click the scene: the style stays near that place.")
            self.reach = gui.add_slider("Reach", 0.05, 2.0, 0.05, far, hint="1 is how far the scene is from the camera")
            everywhere = gui.add_button("Everywhere")

        everywhere.on_click(lambda _: self._pick(None))
        self.reach.on_update(lambda event: event.client and self.request(self.session.wanted.style))
        self.viser.scene.on_click(modifier="shift")(
            lambda event: self._pick(surface_point(self.unstyled, event.ray_origin, event.ray_direction))
        )

    def _pick(self, point: Vector | None) -> None:
        self._point = point
        self.request(self.session.wanted.style)

    def _place(self) -> str:
        """Where the style goes, in the words of ``--mask``."""
        if self._point is None:
            return ""
        reach = self.reach.value * self.path.distance
        return f"sphere:{','.join(f'{number:.4g}' for number in (*self._point, reach))},soft={reach / 4:.4g}"

    def _add_path_controls(self) -> None:
        gui = self.viser.gui
        with gui.add_folder("Camera path", expand_by_default=False, order=3):
            add, clear = gui.add_button("Add keyframe"), gui.add_button("Clear")
            count = gui.add_markdown("")
            self.seconds = gui.add_slider("Seconds", 1, 20, 1, 4)
            preview, render = gui.add_button("Preview"), gui.add_button("Render MP4")

        def set_keyframes(*poses: Tensor) -> None:
            self.path.keyframes = [*poses]
            keyframes = f"{len(poses)} keyframe{'s' * (len(poses) > 1)}."
            count.content = keyframes if poses else "No keyframes: the path goes through the photographs."

        add.on_click(lambda event: event.client and set_keyframes(*self.path.keyframes, pose_of(event.client.camera)))
        clear.on_click(lambda _: set_keyframes())
        set_keyframes()
        preview.on_click(lambda event: event.client and self.path.preview(event.client, self.seconds.value))

        def write_video(path: Path, on_frame: OnFrame) -> None:
            self.path.write_video(self.session.gaussians, path, self.seconds.value, on_frame)

        render.on_click(lambda event: event.client and self._download(event.client, "video.mp4", write_video))

    def _add_save_controls(self) -> None:
        gui = self.viser.gui
        with gui.add_folder("Save", expand_by_default=False, order=4):
            self.format = gui.add_dropdown("Format", catalog().names("format"))
            save = gui.add_button("Download", icon=viser.Icon.DOWNLOAD)
            gui.add_markdown("The command line of what is shown:")
            self.command = gui.add_markdown("")
        save.on_click(
            lambda event: event.client and self._download(event.client, f"scene.{self.format.value}", self._write_scene)
        )

    def request(self, style: str) -> None:
        """Request a style with the current values of the controls."""
        second = next((other for other in self.session.styles() if title_of(other) == self.second.value), "")
        mixed = bool(style and second and second != style)
        mixture = (second, self.amount.value) if mixed else ("", 0.5)
        controls = (self.strength.value, float(self.preserve.value), self._place())
        self.session.request(StyleRequest(style, *mixture, *controls))

    def _open(self, title: str) -> None:
        """Request a saved style that the page's address names; another page may have written that address."""
        if title in self.session.saved or title == UNSTYLED:
            self.request(title if title != UNSTYLED else "")

    def _uploaded(self, file: viser.UploadedFile) -> None:
        try:
            self.request(str(store_upload(self._folder, file.name, file.content)))
        except (UserError, OSError) as error:
            self.status.content = one_line(error)

    def _show_status(self) -> None:
        request, done = self.session.in_progress, self.session.done
        self.progress.visible = request is not None
        self.progress.animated = done is None
        self.progress.value = 100.0 if done is None else 100 * done
        if request is not None:
            self.status.content = f"{title_of(request.style)}: {self.session.status} …"
        else:
            shown = " → ".join(title_of(style) for style in self.session.current.styles) or "unstyled"
            self.status.content = self.session.status or f"Shown: {shown}"

    def _style_changed(self) -> None:
        """Show the session's current style in every browser."""
        with self._lock:
            request, gaussians = self.session.current, self.session.gaussians
            is_new = self._shown is not None and request != self._shown
            self._shown = request
            self._after = splat_arrays(gaussians, self.path)
            for view in self._views.values():
                view.show(self._after, is_new=is_new)
        self._show_status()
        self.command.content = f"```\n{self.session.command(*self._command_words)}\n```"
        if request == StyleRequest(request.style) or request.style not in self._thumbnails:
            self._render_thumbnail(request.style, gaussians)
        self._show_row()
        titles = (NO_STYLE, *(title_of(style) for style in self.session.styles()))
        if self.second.options != titles:
            self.second.options = titles
            self.second.value = next((one for one in titles if one == title_of(self.session.wanted.second)), NO_STYLE)

    def _render_thumbnail(self, style: str, gaussians: Gaussians) -> None:
        self._thumbnails[style] = data_url(to_pil(self.path.thumbnail(gaussians, THUMBNAIL_HEIGHT)), "jpeg", quality=85)
        self._show_row()

    def _show_row(self) -> None:
        self.row.content = style_row(["", *self.session.styles()], self.session.current.style, dict(self._thumbnails))

    def _download(self, client: viser.ClientHandle, name: str, write: Callable[[Path, OnFrame], None]) -> None:
        """Write a file, and send it to one browser."""
        note = client.add_notification(f"Writing {name}", "", loading=True)

        def on_frame(done: int, total: int) -> None:
            note.body = f"{done} of {total} frames"

        try:
            with tempfile.TemporaryDirectory() as folder:
                write(Path(folder) / name, on_frame)
                client.send_file_download(name, (Path(folder) / name).read_bytes(), save_immediately=True)
        except (ValueError, OSError) as error:
            client.add_notification(f"{name} could not be written", one_line(error), color="red")
        finally:
            note.remove()

    def _write_scene(self, path: Path, _: OnFrame) -> None:
        session, title = self.session, title_of(self.session.current.style) or "unstyled"
        if path.suffix == ".html":
            styles = {"unstyled": self.unstyled, **session.cached(), title: session.gaussians}
            styles[title] = styles.pop(title)  # the last one is shown at first
            given = tuple(styles.items()), self.encoded.cameras, tuple(self.encoded.names)
            notes, page_title = session.notes, Path(self._command_words[0]).stem
            shared = {"offset": self.encoded.offset, "pictures": session.pictures()}
            shared["photographed"] = self.encoded.photographed
            export_styles(StyledScene(*given, notes, page_title, **shared), path, "html")
        else:
            one = StyledScene(((title, session.gaussians),), notes=(title, *session.notes), offset=self.encoded.offset)
            export_styles(one, path, path.name.partition(".")[2])
