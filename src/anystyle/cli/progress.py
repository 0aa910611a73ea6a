"""Progress in lines on the standard error stream."""

import sys
import time

from anystyle.types.progress import OnProgress, Progress

INTERVAL = 10.0
"""Seconds between two lines of one stage."""


def progress_lines() -> OnProgress:
    """Print a line as each stage begins and ends, and another every ten seconds."""
    printed, before = -INTERVAL, 1.0

    def write(progress: Progress) -> None:
        nonlocal printed, before
        done = progress.done or 0.0
        if done < before or done >= 1 or time.monotonic() - printed >= INTERVAL:
            print(f"{progress.line} …", file=sys.stderr, flush=True)
            printed = time.monotonic()
        before = done

    return write
