"""Commands in forks of a process that has imported everything: they start in a moment."""

import importlib
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NoReturn

WARM = ("stylize", "data", "report", "evaluate", "study", "study_analyze", "study_power", "weights", "plugins", "train")


def warm(commands: Sequence[str] = WARM) -> None:
    """Import what commands import; the program itself runs them."""
    for name in commands:
        importlib.import_module(f"anystyle.commands.{name}")
        del sys.modules[f"anystyle.commands.{name}"]


def start(
    words: Sequence[str],
    folder: Path,
    said: Path,
    environment: Mapping[str, str] | None = None,
    limits: Mapping[int, int] | None = None,
    instead: Callable[[], object] | None = None,
) -> int:
    """Fork a command.

    Args:
        words: After ``anystyle``.
        folder: It runs there.
        said: The file of what it writes on both streams.
        environment: Variables that it is given.
        limits: Of ``RLIMIT_...``.
        instead: Runs in place of the command.

    Returns:
        The process, which leads a group of its own.
    """
    child = os.fork()
    if child == 0:
        _be(words, folder, said, environment or {}, limits or {}, instead)
    return child


def _be(
    words: Sequence[str],
    folder: Path,
    said: Path,
    environment: Mapping[str, str],
    limits: Mapping[int, int],
    instead: Callable[[], object] | None,
) -> NoReturn:
    code: object = 0
    try:
        os.setsid()
        for name, value in limits.items():
            resource.setrlimit(name, (value, value))
        with said.open("wb") as file:
            for number in (1, 2):
                os.dup2(file.fileno(), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.chdir(folder)
        os.environ.update(environment)
        sys.argv = ["anystyle", *words]
        sys.stdout, sys.stderr = (os.fdopen(number, "w", closefd=False) for number in (1, 2))
        # What starts this may run in the background, where interrupts are ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        from anystyle.__main__ import main

        (instead or main)()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(bool(end.code))
    except KeyboardInterrupt:  # before the program is there to take it
        code = 130
    except BaseException:
        import traceback

        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 1)


def ended(child: int, seconds: float) -> int | None:
    """The exit status of a process, negative after a signal; ``None``, and its end, if it runs longer than that."""
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    kill(child)
    return None


def kill(child: int) -> None:
    """End a process and all that it started, and wait for it."""
    try:
        os.killpg(child, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):  # it has not come to lead a group
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
