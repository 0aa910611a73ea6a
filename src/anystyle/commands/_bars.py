"""How far long work is: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from types import TracebackType

_QUIET_SECONDS = 10.0


class Bar:
    """Told of stages, shows a progress bar for each; without a terminal a line for each stage, and now and then one."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._stage = ""
        self._spoken = 0.0
        self._bars = None
        self._task = None

    def __enter__(self) -> "Bar":
        if self._terminal:
            from rich.console import Console
            from rich.progress import Progress, TimeRemainingColumn

            self._bars = Progress(
                *Progress.get_default_columns()[:-1], TimeRemainingColumn(), console=Console(stderr=True)
            )
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Say how far a stage is."""
        if self._bars is not None:
            if stage != self._stage:
                self._task = self._bars.add_task(stage, total=total)
            assert self._task is not None
            self._bars.update(self._task, completed=done, total=total)
        elif stage != self._stage or done == total or time.monotonic() - self._spoken > _QUIET_SECONDS:
            print(f"{stage} {done}/{total} …", file=sys.stderr, flush=True)
            self._spoken = time.monotonic()
        self._stage = stage
