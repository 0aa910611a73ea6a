"""Stages of a command: timed, and told in plain lines as they begin."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager


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
