"""Other processes."""

import subprocess
from contextlib import suppress

import psutil


def kill(process: subprocess.Popen) -> None:
    """Kill a process with all that it started, on every system."""
    with suppress(psutil.NoSuchProcess):
        first = psutil.Process(process.pid)
        for each in (first, *first.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                each.kill()
