"""Styles of one scene on request: computed in the background, the newest request first, the last few cached."""

import logging
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from shlex import join

from PIL import Image

from anystyle.data.images import open_image
from anystyle.errors import UserError, one_line
from anystyle.io.atomic import write_json
from anystyle.io.cache import LRUCache
from anystyle.io.documents import kept_json
from anystyle.pipeline.controls import Controls, applied, blended
from anystyle.pipeline.masks import parsed
from anystyle.pipeline.request import Request, inputs_of
from anystyle.pipeline.results import Restyler
from anystyle.pipeline.styles import EmbeddedStyle, Mixture, embed_styles, slug
from anystyle.pipeline.words import args_of
from anystyle.types import Gaussians, Progress
from anystyle_viewer.server import title_of

_log = logging.getLogger(__name__)
CACHE_SIZE = 8
"""Styled scenes in memory, so that going back to one is instant."""
MAX_RECENT = 24


@dataclass(frozen=True)
class StyleRequest:
    """What the scene should look like; a style is a text, the path of an uploaded image, or a saved style's title."""

    style: str = ""
    second: str = ""
    amount: float = 0.5  # how far towards the second style
    strength: float = 1.0
    preserve_color: float = 0.0
    place: str = ""  # where, as ``--mask`` has it; empty is everywhere

    @property
    def styles(self) -> tuple[str, ...]:
        """Both styles, one or none."""
        return tuple(filter(None, (self.style, self.second)))

    @property
    def controls(self) -> Controls:
        """How the style is applied."""
        return Controls(self.strength, self.preserve_color, mask=parsed(self.place) if self.place else None)


@dataclass(frozen=True)
class SavedSession:
    """``session.json``: what is restored when the viewer starts again."""

    recent: tuple[str, ...] = ()
    request: StyleRequest = field(default_factory=StyleRequest)


class Superseded(Exception):
    """There is a newer request than the one being computed."""


class Session:
    """One scene and its current style, shared by all browsers."""

    def __init__(
        self,
        restyler: Restyler,
        *,
        saved: Mapping[str, Gaussians] | None = None,
        folder: Path | None = None,
        notes: Sequence[str] = (),
        pictures: Mapping[str, Image.Image] | None = None,
    ) -> None:
        self.restyler, self.saved, self.folder, self.notes = restyler, dict(saved or {}), folder, tuple(notes)
        self._pictures = dict(pictures or {})
        # Called from the background thread when another style is ready, and when :attr:`status` has changed.
        self.on_change: Callable[[], None] = lambda: None
        self.on_status: Callable[[], None] = lambda: None
        restored = (kept_json(folder / "session.json", SavedSession) if folder is not None else None) or SavedSession()
        self.recent = list(restored.recent)
        self.current, self.gaussians = StyleRequest(), restyler.unstyled
        self.wanted = StyleRequest()
        """The latest request, which may not be finished."""
        self.status, self.done = "", None
        self.in_progress: StyleRequest | None = None
        self._embedded: LRUCache[tuple[str, str, float], EmbeddedStyle] = LRUCache(CACHE_SIZE)
        self._scenes: LRUCache[StyleRequest, Gaussians] = LRUCache(CACHE_SIZE)
        self._pending: StyleRequest | None = None
        self._wake, self._closed = threading.Condition(), False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()
        if restored.request != StyleRequest():
            self.request(restored.request)
        elif self.saved:
            self.request(StyleRequest(list(self.saved)[-1]))

    def request(self, request: StyleRequest) -> None:
        """Ask for a style; replaces earlier requests that are not finished."""
        with self._wake:
            self.wanted = self._pending = request
            self._wake.notify()

    def close(self) -> None:
        """End the background thread."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._thread.join(timeout=60)

    def styles(self) -> list[str]:
        """All styles that were requested or saved, the newest first."""
        return [*self.recent, *(style for style in self.saved if style not in self.recent)]

    def cached(self) -> dict[str, Gaussians]:
        """The scene in those styles, without further controls, that need not be computed, by title."""
        requests = ((style, StyleRequest(style)) for style in reversed(self.styles()))
        return {
            title_of(style): self.scene(request)
            for style, request in requests
            if style in self.saved or request in self._scenes
        }

    def pictures(self) -> dict[str, Image.Image]:
        """The pictures of styles that are given as images, by title."""
        uploaded = {style: self.image_file(style) for style in self.recent}
        return self._pictures | {title_of(style): open_image(file) for style, file in uploaded.items() if file}

    def command(self, inputs: str, words: Sequence[str] = ()) -> str:
        """The command line that reproduces the current style of ``inputs``, opened with the overrides ``words``."""
        request, styles = self.current, self.current.styles
        if any(style in self.saved for style in styles):
            return f"# made from results in {inputs}"
        given = tuple(self.image_file(style) or style for style in styles)
        controls = request.controls if request.style else Controls(0.0, request.preserve_color)
        name = "_".join(slug(style if isinstance(style, str) else style.stem) for style in given) or "unstyled"
        mixed = (Mixture(given[0], given[1], request.amount),) if request.second else given or ("none",)
        args = args_of(Request(inputs_of(inputs), mixed, (controls,), tuple(words)))
        return join(["anystyle", "stylize", *args, "--out", f"styled-{name}"])

    def image_file(self, style: str) -> Path | None:
        """The uploaded image of a style, wherever the folder was then; a path to any other file is taken as a text."""
        name = Path(style).name
        if self.folder is None or len(name.encode()) > 255 or not re.fullmatch(r"[^\0]+-[0-9a-f]{8}\.png", name):
            return None
        return self.folder / name if (self.folder / name).is_file() else None

    def scene(self, request: StyleRequest) -> Gaussians:
        """The Gaussians in a style."""
        if not request.style:
            return self.restyler.unstyled
        controls = request.controls
        if request.style in self.saved or request.second in self.saved:
            # The embedding of a saved style is not known: styled scenes are mixed instead.
            first, *others = (self.saved.get(style) or self.scene(StyleRequest(style)) for style in request.styles)
            mixed = blended(first, others[0], request.amount) if others else first
            weights = self.restyler.mask_weights(controls.mask)
            return mixed if controls == Controls() else applied(controls, self.restyler.unstyled, mixed, weights)
        key = (request.style, request.second, request.amount if request.second else 0.0)
        return self.restyler(self._embedded.get(key, lambda: self._embed(request)).under(controls), self._report)

    def _embed(self, request: StyleRequest) -> EmbeddedStyle:
        first, second = (self.image_file(style) or style for style in (request.style, request.second))
        style = Mixture(first, second, request.amount) if request.second else first
        return embed_styles([style], self.restyler.encoded.stylizer)[0]

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._pending is not None or self._closed)
                if self._closed:
                    return
                request, self._pending = self._pending or StyleRequest(), None
            if request not in self._scenes:
                self.in_progress, self.status, self.done = request, "painting", None
                self.on_status()
            try:
                gaussians = self._scenes.get(request, lambda: self.scene(request))  # noqa: B023
            except Superseded:
                continue
            except Exception as error:
                if not isinstance(error, UserError | OSError | MemoryError):
                    _log.exception("the style could not be computed")  # a bug, of the project or of a plugin
                self.in_progress, self.status = None, one_line(error) or type(error).__name__
                self.on_status()
            else:
                self.in_progress, self.status = None, ""
                self.current, self.gaussians = request, gaussians
                try:
                    self._save(request)
                except (UserError, OSError) as error:
                    self.status = f"this style is not kept for the next start: {one_line(error)}"
                self.on_change()

    def _report(self, progress: Progress) -> None:
        if self._pending is not None or self._closed:
            raise Superseded
        self.status, self.done = progress.line, progress.done
        self.on_status()

    def _save(self, request: StyleRequest) -> None:
        # The title of a saved style would be a text to a session on another scene.
        asked = [style for style in request.styles if style not in self.saved]
        self.recent = list(dict.fromkeys((*asked, *self.recent)))[:MAX_RECENT]
        if self.folder is not None:
            kept = request if len(asked) == len(request.styles) else StyleRequest()
            write_json(self.folder / "session.json", asdict(SavedSession(tuple(self.recent), kept)))
