"""Stages of a run: timed, and reported as they begin."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from anystyle.types import OnProgress, Progress

INTERVAL = 5.0
"""Seconds between two reports of progress within a stage."""


class Stages:
    """Times the stages of one run.

    Args:
        report: Called with a stage's name as it begins, and every few seconds while it goes on.
    """

    def __init__(self, report: Callable[[str, Progress], None] = lambda stage, progress: None) -> None:
        self.seconds: dict[str, float] = {}
        self._report, self._reported = report, 0.0

    @contextmanager
    def __call__(self, stage: str, line: str = "") -> Iterator[OnProgress]:
        """Run one stage; the block gets a callback for its progress. Times of stages of one name add up."""
        self.note(stage, line)
        start = time.perf_counter()
        try:
            yield partial(self._progress, stage)
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start

    @property
    def write_share(self) -> float:
        """The fraction of all seconds so far that the run waited for its files."""
        return self.seconds.get("write", 0.0) / max(sum(self.seconds.copy().values()), 1e-9)

    def report(self) -> dict[str, object]:
        """Seconds a stage so far, for ``report.json``."""
        seconds = {stage: round(seconds, 4) for stage, seconds in self.seconds.copy().items()}
        return {"seconds": seconds, "write_share": round(self.write_share, 4)}

    def note(self, stage: str, line: str) -> None:
        """Report a line at once."""
        self._reported = time.perf_counter()
        self._report(stage, Progress(line))

    def _progress(self, stage: str, progress: Progress) -> None:
        if time.perf_counter() - self._reported > INTERVAL:
            self._reported = time.perf_counter()
            self._report(stage, progress)
