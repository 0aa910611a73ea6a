"""Stages of a run: timed, and announced as they begin."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from torch import Tensor

from anystyle.methods.contract import Progress

QUIET = 5.0
"""Seconds between two announcements of progress."""


class Stages:
    """Times the stages of one run.

    Args:
        on_stage: Called with a stage's name and what it works on as the stage begins.
        on_thumbnail: Called with a picture of what is worked on, where there is one.
    """

    def __init__(
        self,
        on_stage: Callable[[str, str], None] = lambda name, note: None,
        on_thumbnail: Callable[[Tensor], None] = lambda thumbnail: None,
    ) -> None:
        self._on_thumbnail = on_thumbnail
        self.seconds: dict[str, float] = {}
        self._on_stage = on_stage
        self._announced = 0.0

    @contextmanager
    def __call__(self, name: str, note: str = "") -> Iterator[None]:
        """Run one stage; the times of stages of one name add up."""
        self._on_stage(name, note)
        start = self._announced = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def note(self, name: str, note: str) -> None:
        """Announce something of a stage at once."""
        self._announced = time.perf_counter()
        self._on_stage(name, note)

    def progress(self, name: str, note: str) -> None:
        """Announce where a stage is, unless something was announced in the last seconds."""
        if time.perf_counter() - self._announced > QUIET:
            self.note(name, note)

    def watch(self, name: str, progress: Progress) -> None:
        """Announce where a method is, and show what it has so far, unless that was done in the last seconds."""
        if progress.thumbnail is not None and time.perf_counter() - self._announced > QUIET:
            self._on_thumbnail(progress.thumbnail)
        self.progress(name, progress.line)
