"""Live viewers of finished scenes: one process each, on a loopback port, that ends when no browser is open."""

import re
import subprocess
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from anystyle_start.jobs import spawned
from anystyle_start.library import ERROR

IDLE = 120
"""Seconds without a browser after which a viewer ends."""
_ADDRESS = re.compile(r"(http://127\.0\.0\.1:\d+/) ")


@dataclass
class ViewerProcess:
    """A viewer: starting while it has neither an address nor an error."""

    process: subprocess.Popen[str]
    address: str = ""
    error: str = ""


class Viewers:
    """The viewers that run; ``program`` are the words that start ``anystyle``."""

    def __init__(self, program: Sequence[str]) -> None:
        self.program = tuple(program)
        self._viewers: dict[str, ViewerProcess] = {}
        self._lock = threading.Lock()

    def start(self, scene: str, results: Path, keep: Path, words: Sequence[str]) -> ViewerProcess:
        """The viewer of a scene, started unless it runs."""
        with self._lock:
            viewer = self._viewers.get(scene)
            if viewer is None or viewer.process.poll() is not None:
                options = ["--port", "0", "--keep", str(keep), "--close-after", str(IDLE)]
                command = [*self.program, "view", str(results), *options, *words]
                process = spawned(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
                viewer = self._viewers[scene] = ViewerProcess(process)
                threading.Thread(target=_follow, args=(viewer,), daemon=True).start()
            return viewer

    def of(self, scene: str) -> ViewerProcess | None:
        """The viewer of a scene, where one runs or has failed."""
        viewer = self._viewers.get(scene)
        return None if viewer is None or (viewer.process.poll() is not None and not viewer.error) else viewer

    def close(self, scene: str) -> None:
        """End the viewer of a scene."""
        with self._lock:
            viewer = self._viewers.pop(scene, None)
        if viewer is not None:
            viewer.process.terminate()
            try:
                viewer.process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                viewer.process.kill()

    def close_all(self) -> None:
        """End all viewers."""
        for scene in list(self._viewers):
            self.close(scene)


def _follow(viewer: ViewerProcess) -> None:
    assert viewer.process.stdout is not None
    with viewer.process.stdout as lines:
        for line in lines:
            if match := _ADDRESS.match(line):
                viewer.address = match[1]
            elif line.startswith(ERROR):
                viewer.error = line.removeprefix(ERROR).strip()
    if viewer.process.wait() and not viewer.address:
        viewer.error = viewer.error or "the viewer ended before it was ready"
