"""Styles of one scene as people ask for them: computed in the background, the newest first, the last ones kept."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import join

from anystyle.caching import LRUCache
from anystyle.documents import kept_json
from anystyle.errors import one_line
from anystyle.inference.controlled import Controlled
from anystyle.inference.controls import Controls
from anystyle.inference.styles import EmbeddedStyle, Mixture, StyleInput, embed_styles
from anystyle.io.atomic import write_json
from anystyle.types import Gaussians

KEPT = 8
"""Scenes in styles that are kept, so that going back to one is instant."""


@dataclass(frozen=True)
class Wish:
    """What is asked for.

    Args:
        style: A text, a picture's path or the title of a saved style; empty for the unstyled scene.
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

    def command(self, inputs: str) -> str:
        """The command line that gives the same result."""
        words = ["anystyle", "stylize", inputs]
        for style in filter(None, (self.style, self.second)):
            words += ["--image" if Path(style).is_file() else "--text", style]
        words += ["--mix", f"{self.amount:g}"] if self.second else []
        words += (
            ["--strength", f"{self.strength if self.style else 0:g}"] if self.strength < 1 or not self.style else []
        )
        words += ["--preserve-color", f"{self.preserve_color:g}"] if self.preserve_color else []
        return join(words)


@dataclass(frozen=True)
class Kept:
    """What outlives the program: the styles that were asked for, the newest first, and what was looked at."""

    recent: tuple[str, ...] = ()
    wish: Wish = Wish()


class Session:
    """One scene, and what is looked at of it; any number of people may ask.

    Args:
        unstyled: The scene itself.
        saved: Styles that are there already, by title.
        controlled: Gives the scene further styles; ``None`` where no model can.
        file: Where what was asked for is kept; ``None`` forgets it.
        on_change: Called from the background when a wish is fulfilled, or says why it is not.
    """

    def __init__(
        self,
        unstyled: Gaussians,
        *,
        saved: Mapping[str, Gaussians] | None = None,
        controlled: Controlled | None = None,
        file: Path | None = None,
        on_change: Callable[[], None] = lambda: None,
    ) -> None:
        self.unstyled, self.saved, self.controlled, self._file = unstyled, dict(saved or {}), controlled, file
        self.on_change = on_change
        kept = (kept_json(file, Kept) if file is not None else None) or Kept()
        self.recent = list(kept.recent)
        self.shown, self.gaussians = Wish(), unstyled
        self.status = ""
        self._embedded: LRUCache[tuple[str, str, float], EmbeddedStyle] = LRUCache(4 * KEPT)
        self._scenes: LRUCache[Wish, Gaussians] = LRUCache(KEPT)
        self._wanted: Wish | None = None
        self._wake, self._closed = threading.Condition(), False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()
        if kept.wish != Wish():
            self.ask(kept.wish)

    def ask(self, wish: Wish) -> None:
        """Ask for something; what was asked for before and is not begun is dropped."""
        with self._wake:
            self._wanted = wish
            self._wake.notify()

    def close(self) -> None:
        """End the background work."""
        with self._wake:
            self._closed = True
            self._wake.notify()
        self._thread.join(timeout=60)

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._wanted is not None or self._closed)
                if self._closed:
                    return
                wish, self._wanted = self._wanted or Wish(), None
            if wish not in self._scenes:
                self.status = f"painting {wish.style[:60]} …"
                self.on_change()
            try:
                gaussians = self._scenes.get(wish, lambda: self.scene(wish))  # noqa: B023
            except (ValueError, OSError, MemoryError) as error:
                self.status = one_line(error) or type(error).__name__
            else:
                self.shown, self.gaussians, self.status = wish, gaussians, ""
                self._remember(wish)
            self.on_change()

    def scene(self, wish: Wish) -> Gaussians:
        """The Gaussians that a wish is about.

        Raises:
            ValueError: It cannot be fulfilled.
        """
        if not wish.style:
            return self.unstyled
        plain = wish == Wish(style=wish.style)
        if plain and wish.style in self.saved:
            return self.saved[wish.style]
        if self.controlled is None:
            raise ValueError("no model here can give this scene a new style; open photographs or their results")
        key = (wish.style, wish.second, wish.amount)
        style = self._embedded.get(key, lambda: self._embed(wish))
        return self.controlled.gaussians(style.under(Controls(wish.strength, wish.preserve_color)))

    def _embed(self, wish: Wish) -> EmbeddedStyle:
        assert self.controlled is not None
        one: StyleInput = _given(wish.style)
        given = Mixture(one, _given(wish.second), wish.amount) if wish.second else one
        return embed_styles([given], self.controlled.encoded.stylizer)[0]

    def _remember(self, wish: Wish) -> None:
        for style in filter(None, (wish.second, wish.style)):
            self.recent = [style, *(other for other in self.recent if other != style)][:24]
        if self._file is not None:
            write_json(self._file, asdict(Kept(tuple(self.recent), wish)))


def _given(style: str) -> str | Path:
    """A style as the library takes it; titles of texts lose their quotation marks."""
    path = Path(style)
    return path if len(style) < 4096 and "\0" not in style and path.is_file() else style.strip("“”")
