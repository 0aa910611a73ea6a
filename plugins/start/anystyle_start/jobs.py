"""Runs of ``anystyle stylize``, one at a time, each in a process of its own that can be ended."""

import logging
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from anystyle.io.process import kill
from anystyle_start.library import ACTIVE, Job, Library, Record, Settings
from anystyle_start.progress import State, follow

_log = logging.getLogger(__name__)
PATIENCE = 15.0
"""Seconds that a process gets to clear away what it began."""


def spawned(command: Sequence[str], **outputs: Any) -> subprocess.Popen[str]:
    """A process of its own that gets no input; the ``outputs`` are text."""
    return subprocess.Popen(
        command, stdin=subprocess.DEVNULL, text=True, errors="replace", start_new_session=True, **outputs
    )


class Jobs:
    """The queue of runs of a library's scenes.

    Args:
        library: The scenes.
        program: The words that start ``anystyle``.
        on_result: Called with a scene when its results are new.
    """

    def __init__(self, library: Library, program: Sequence[str], on_result: Callable[[str], None]) -> None:
        self.library, self.program, self.on_result = library, tuple(program), on_result
        self.state, self.started = State(), 0.0
        """Of the run that goes on."""
        self.waiting: list[str] = []
        """Ids of scenes, the next one first."""
        self.running: str | None = None
        self._process: subprocess.Popen[str] | None = None
        self._ending: str = ""
        """Why the run that goes on was ended: the state that its scene gets."""
        self._changed, self._closed = threading.Condition(), False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def submit(self, scene: str, settings: Settings, words: Sequence[str]) -> None:
        """Queue a run of a scene, unless there is one."""
        with self._changed:
            if self.library[scene].job.state in ACTIVE:
                return

            def queued(record: Record) -> Record:
                job = Job("waiting", number=record.job.number + 1, words=tuple(words))
                return replace(record, settings=settings, job=job)

            self.library.update(scene, queued)
            self.waiting.append(scene)
            self._changed.notify_all()

    def cancel(self, scene: str, state: str = "cancelled") -> None:
        """End the run of a scene, and wait until it has ended."""
        with self._changed:
            if scene in self.waiting:
                self.waiting.remove(scene)
                self.library.set_job(scene, state=state)
            elif scene == self.running:
                self._ending = state
                if self._process is not None:
                    _end(self._process)
                self._changed.wait_for(lambda: self.running != scene, timeout=2 * PATIENCE)

    def close(self) -> None:
        """End everything; what ran or waited is marked as interrupted."""
        with self._changed:
            self._closed = True
            for scene in [*self.waiting, *filter(None, [self.running])]:
                self.cancel(scene, "interrupted")
            self._changed.notify_all()
        self._thread.join(timeout=2 * PATIENCE)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self.waiting or self._closed)
                if self._closed:
                    return
                self.running, self._ending, self.state, self.started = self.waiting.pop(0), "", State(), time.time()
            try:
                self._run(self.running)
            except Exception as error:  # a bug of one run, logged with its traceback
                _log.exception("a run ended unexpectedly")  # the queue goes on
                with suppress(ValueError, OSError):
                    self.library.set_job(self.running, state="failed", error=f"{type(error).__name__}: {error}")
            with self._changed:
                self.running = None
                self._changed.notify_all()

    def _run(self, scene: str) -> None:
        record = self.library.set_job(scene, state="running")
        number, log = record.job.number, self.library.log(scene, record.job.number)
        target = self.library.run(scene, number)
        target.parent.mkdir(exist_ok=True)
        command = [*self.program, "stylize", *record.job.words, "--export", "html", "--out", str(target)]
        status = None
        with self._changed:
            if not self._ending:
                # A program whose reader has gone ends at its next line: none outlives this one.
                self._process = spawned(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        if self._process is not None:
            self._follow(self._process, log, record)
            status = self._process.wait()
            self._process = None
        self._finish(scene, number, status)

    def _follow(self, process: subprocess.Popen[str], log: Path, record: Record) -> None:
        assert process.stderr is not None
        with log.open("w", encoding="utf-8") as file, process.stderr:
            for line in process.stderr:
                file.write(line)
                file.flush()
                self.state = follow(self.state, line, record.kind)

    def _finish(self, scene: str, number: int, status: int | None) -> None:
        seconds, notes = round(time.time() - self.started, 1), self.state.notes
        before = self.library[scene].result
        if status == 0 and not self._ending:
            self.library.update(scene, lambda record: replace(record, result=number))
            self.library.set_job(scene, state="done", seconds=seconds, notes=notes, error="")
            if before is not None:
                self.on_result(scene)
                self.library.drop_run(scene, before)
            return
        self.library.drop_run(scene, number)
        error = "" if self._ending else self.state.error or _reason(status)
        self.library.set_job(scene, state=self._ending or "failed", seconds=seconds, notes=notes, error=error)


def _reason(status: int | None) -> str:
    if status == -9:  # SIGKILL, which not every system has
        return "the system ended the work, as it does where memory runs out; use fewer photographs or a lower quality"
    return f"the work ended with an error of the program (exit status {status}), which the log tells"


def _end(process: subprocess.Popen[str]) -> None:
    """Ask a process to end; after a while it is killed with what it started."""

    def end() -> None:
        if process.poll() is None:
            kill(process)

    process.terminate()
    timer = threading.Timer(PATIENCE, end)
    timer.daemon = True
    timer.start()
