"""A scene, its session and its page behind one door."""

import contextlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

import viser

from anystyle.viewer.door import LOOPBACK, Door
from anystyle.viewer.flight import Flight, Render
from anystyle.viewer.page import LARGEST, page
from anystyle.viewer.panel import Panel
from anystyle.viewer.session import OpenScene, Session

VISER_PAGE = Path(viser.__file__).parent / "client" / "build" / "index.html"


class Viewer:
    """A running viewer; as a context it ends with it.

    Args:
        scene: What is looked at.
        render: Renders cameras one by one.
        folder: Where styles, pictures and keyframes are kept.
        command: What was opened and the words it was opened with, as a command line has them.
        host: The address to listen at.
        port: 0 takes a free one.
        token: See :class:`~anystyle.viewer.door.Door`.

    Raises:
        OSError: The address or the port cannot be had.
    """

    def __init__(
        self,
        scene: OpenScene,
        render: Render,
        *,
        folder: Path,
        command: tuple[str, Sequence[str]],
        host: str = LOOPBACK[0],
        port: int = 0,
        token: str | None = None,
    ) -> None:
        self.session = Session(scene.controlled, saved=scene.saved, folder=folder)
        self.flight = Flight(scene.cameras, scene.unstyled, render, folder / "keyframes.json")
        with contextlib.redirect_stdout(io.StringIO()):  # it tells its own address, which is not the door's
            self.server = viser.ViserServer(LOOPBACK[0], 0, label="anystyle", verbose=False)
        self.panel = Panel(self.server, scene, self.session, self.flight, folder=folder, command=command)
        self.door = Door(
            target=self.server.get_port(),
            host=host,
            port=port,
            token=token,
            page=page(VISER_PAGE, LARGEST),
            answers={"/picture": self._picture, "/style": self._style},
            largest=LARGEST,
        )

    def __enter__(self) -> "Viewer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.door.close()
        self.session.close()
        self.server.stop()

    def _picture(self, query: Mapping[str, str], body: bytes) -> None:
        self.panel.ask_picture(query.get("name", ""), body)

    def _style(self, query: Mapping[str, str], body: bytes) -> None:
        style = body.decode("utf-8", errors="replace")
        if style and style not in self.session.styles():
            raise ValueError(f"{style[:60]!r} was not asked for yet; type it as a text")
        self.panel.ask(style)
