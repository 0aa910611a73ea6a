"""Stages of a command: timed, and shown as a bar on a terminal or as plain lines elsewhere."""

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")


class Stages:
    """Times the stages of one command and tells the user where it stands.

    Args:
        quiet: Say nothing; time only.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self.seconds: dict[str, float] = {}
        self._quiet = quiet

    @contextmanager
    def __call__(self, name: str, note: str = "") -> Iterator[None]:
        """Run one stage; the times of stages of one name add up."""
        if not self._quiet:
            print(f"{name} {note}".rstrip() + " …", file=sys.stderr, flush=True)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def track(self, items: Iterable[T], name: str, total: int | None = None) -> Iterator[T]:
        """Iterate with a progress bar on a terminal, and silently elsewhere."""
        if self._quiet or not sys.stderr.isatty():
            yield from items
            return
        from rich.console import Console
        from rich.progress import track

        count = total if total is not None else len(items) if isinstance(items, Sized) else None
        yield from track(items, description=name, total=count, console=Console(stderr=True), transient=True)
