"""Styles of one scene as people ask for them: computed in the background, the newest first, the last ones kept."""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from shlex import join

from jaxtyping import Float
from torch import Tensor

from anystyle.caching import LRUCache
from anystyle.documents import kept_json
from anystyle.errors import one_line
from anystyle.inference.controls import Controls, applied, blended
from anystyle.inference.encoding import EncodedCapture
from anystyle.inference.results import Controlled
from anystyle.inference.saved import UNSTYLED, SavedScene
from anystyle.inference.styles import EmbeddedStyle, Mixture, embed_styles, slug
from anystyle.io.atomic import write_json
from anystyle.methods.contract import Method, Progress
from anystyle.types import Cameras, Gaussians
from anystyle.viewer.page import name_of

KEPT = 8
"""Scenes in styles that are kept, so that going back to one is instant."""


@dataclass(frozen=True)
class OpenScene:
    """A scene to look at.

    Args:
        unstyled: The scene itself; of a lone file, what it shows.
        cameras: To look from, a batch of one scene.
        names: Of the cameras.
        pictures: What each camera saw, or a render.
        controlled: Gives new styles.
        saved: Styles that are there already, by title.
        notes: Lines on where it comes from, such as licences.
    """

    unstyled: Gaussians
    cameras: Cameras
    names: tuple[str, ...]
    pictures: Float[Tensor, "V 3 H W"]
    controlled: Controlled
    saved: Mapping[str, Gaussians] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def opened_scene(
    encoded: EncodedCapture,
    method: Method | None = None,
    saved: SavedScene | None = None,
    notes: Sequence[str] = (),
) -> OpenScene:
    """What was encoded: photographs, or the renders of a scene that was saved.

    Args:
        encoded: The capture.
        method: How it takes styles; ``None`` for the single pass.
        saved: The scene, where one was saved.
        notes: Of the model, such as licences.
    """
    controlled = Controlled(encoded, method, keep=KEPT)
    pictures, cameras = encoded.views.images[0], encoded.cameras
    styles = {title: scene for title, scene in saved.styles if title != UNSTYLED} if saved else {}
    lines = tuple(dict.fromkeys((*(saved.notes if saved else ()), *notes)))
    return OpenScene(controlled.unstyled, cameras, tuple(encoded.names), pictures, controlled, styles, lines)


MOST_RECENT = 24


@dataclass(frozen=True)
class Wish:
    """What is asked for.

    Args:
        style: A text, the path of a picture that was given or the title of a saved style; empty for no style.
        second: Another style to go towards; empty for none.
        amount: How far, in [0, 1].
        strength: See :class:`~anystyle.inference.controls.Controls`.
        preserve_color: Likewise.
    """

    style: str = ""
    second: str = ""
    amount: float = 0.5
    strength: float = 1.0
    preserve_color: float = 0.0

    @property
    def styles(self) -> tuple[str, ...]:
        """One, two or none."""
        return tuple(filter(None, (self.style, self.second)))

    @property
    def controls(self) -> Controls:
        """How the style is applied."""
        return Controls(self.strength, self.preserve_color)


@dataclass(frozen=True)
class Kept:
    """What outlives the program: the styles that were asked for, the newest first, and what was looked at."""

    recent: tuple[str, ...] = ()
    wish: Wish = Wish()


class Superseded(Exception):
    """What is being painted is not wanted any more."""


class Session:
    """One scene, and what is looked at of it; any number of people may ask.

    Args:
        controlled: Gives the scene its styles.
        saved: Styles that are there already, by title.
        folder: Where pictures are that people gave, and what was asked for is kept; ``None`` takes and keeps none.
        on_change: Called from the background when a wish is fulfilled.
        on_status: Called from the background when there is something to say.
    """

    def __init__(
        self,
        controlled: Controlled,
        *,
        saved: Mapping[str, Gaussians] | None = None,
        folder: Path | None = None,
        on_change: Callable[[], None] = lambda: None,
        on_status: Callable[[], None] = lambda: None,
    ) -> None:
        self.controlled, self.saved, self._folder = controlled, dict(saved or {}), folder
        self.on_change, self.on_status = on_change, on_status
        controlled.on_progress = self._tell
        kept = (kept_json(folder / "session.json", Kept) if folder is not None else None) or Kept()
        self.recent = list(kept.recent)
        self.shown, self.gaussians = Wish(), controlled.unstyled
        self.status, self.done = "", None
        self.painting: Wish | None = None
        self._embedded: LRUCache[tuple[str, str, float], EmbeddedStyle] = LRUCache(KEPT)
        self._scenes: LRUCache[Wish, Gaussians] = LRUCache(KEPT)
        self._wanted: Wish | None = None
        self._wake, self._closed = threading.Condition(), False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()
        if kept.wish != Wish():
            self.ask(kept.wish)

    def ask(self, wish: Wish) -> None:
        """Ask for something; what was asked for before and is not done is dropped."""
        with self._wake:
            self._wanted = wish
            self._wake.notify()

    def close(self) -> None:
        """End the background work."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._thread.join(timeout=60)

    def styles(self) -> list[str]:
        """All that were asked for or saved, the newest first."""
        return [*self.recent, *(style for style in self.saved if style not in self.recent)]

    def kept(self) -> dict[str, Gaussians]:
        """Styles without further controls whose scenes are at hand, by title."""
        wishes = ((style, Wish(style)) for style in reversed(self.styles()))
        return {
            name_of(style): self.scene(wish) for style, wish in wishes if style in self.saved or wish in self._scenes
        }

    def command(self, inputs: str, words: Sequence[str] = ()) -> str:
        """The command line that gives what is shown; what was saved before says where it is.

        Args:
            inputs: What was opened.
            words: Hydra's, that it was opened with.
        """
        wish = self.shown
        styles = wish.styles
        if any(style in self.saved for style in styles):
            return f"# made of results in {inputs}"
        command = ["anystyle", "stylize", inputs]
        for style in styles or ("none",):
            command += ["--image" if self.picture(style) else "--text", style]
        command += ["--mix", f"{wish.amount:g}"] if wish.second else []
        strength = wish.strength if wish.style else 0.0
        command += ["--strength", f"{strength:g}"] if strength < 1 else []
        command += ["--preserve-color", f"{wish.preserve_color:g}"] if wish.preserve_color else []
        name = "_".join(slug(Path(style).stem if self.picture(style) else style) for style in styles)
        return join([*command, "--out", f"styled-{name or 'unstyled'}", *words])

    def picture(self, style: str) -> Path | None:
        """The file, where a style is a picture that somebody gave; no other file of this machine is read."""
        inside = self._folder is not None and len(style) < 4096 and Path(style).parent == self._folder
        return Path(style) if inside and "\0" not in style and Path(style).is_file() else None

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._wanted is not None or self._closed)
                if self._closed:
                    return
                wish, self._wanted = self._wanted or Wish(), None
            if wish not in self._scenes:
                self.painting, self.status, self.done = wish, "painting", None
                self.on_status()
            try:
                gaussians = self._scenes.get(wish, lambda: self.scene(wish))  # noqa: B023
            except Superseded:
                continue
            except (ValueError, OSError, MemoryError) as error:
                self.painting, self.status = None, one_line(error) or type(error).__name__
                self.on_status()
            else:
                self.painting, self.status = None, ""
                self.shown, self.gaussians = wish, gaussians
                self._remember(wish)
                self.on_change()

    def _tell(self, progress: Progress) -> None:
        """Say where a method is, and end it where something else is wanted by now."""
        if self._wanted is not None or self._closed:
            raise Superseded
        self.status, self.done = progress.line, progress.done
        self.on_status()

    def scene(self, wish: Wish) -> Gaussians:
        """The Gaussians that a wish is about.

        Raises:
            ValueError: It cannot be fulfilled.
        """
        if not wish.style:
            return self.controlled.unstyled
        if wish.style in self.saved or wish.second in self.saved:
            return self._mixed(wish)
        key = (wish.style, wish.second, wish.amount if wish.second else 0.0)
        return self.controlled.gaussians(self._embedded.get(key, lambda: self._embed(wish)).under(wish.controls))

    def _mixed(self, wish: Wish) -> Gaussians:
        """Of scenes, where one was saved and its style is not known any more."""
        first, second = (self.saved.get(style) or self.scene(Wish(style)) for style in (wish.style, wish.second))
        mixed = blended(first, second, wish.amount) if wish.second else first
        return mixed if wish.controls == Controls() else applied(wish.controls, self.controlled.unstyled, mixed)

    def _embed(self, wish: Wish) -> EmbeddedStyle:
        first, second = (self.picture(style) or style for style in (wish.style, wish.second))
        given = Mixture(first, second, wish.amount) if wish.second else first
        return embed_styles([given], self.controlled.encoded.stylizer)[0]

    def _remember(self, wish: Wish) -> None:
        for style in reversed(wish.styles):
            self.recent = [style, *(other for other in self.recent if other != style)][:MOST_RECENT]
        if self._folder is not None:
            write_json(self._folder / "session.json", asdict(Kept(tuple(self.recent), wish)))
