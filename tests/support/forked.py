"""Commands in forks of a process that has imported everything: they start in a moment."""

import importlib
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from anystyle.__main__ import main
from anystyle.registry.catalog import catalog

COMMANDS = ("stylize", "report", "evaluate", "weights", "plugins", "train")
MEMORY = 8 << 30


def warm() -> None:
    """Import what commands import; the program itself runs them."""
    for name in COMMANDS:
        importlib.import_module(f"anystyle.commands.{name}")
        del sys.modules[f"anystyle.commands.{name}"]
    catalog().find("command", "data").load()


def start(words: Sequence[str], folder: Path, output: Path, environment: Mapping[str, str] | None = None) -> int:
    """Fork ``anystyle WORDS`` in a folder; both streams go to ``output``. Returns the process, a group's leader."""
    child = os.fork()
    if child:
        return child
    code: object = 0
    try:
        os.setsid()
        sys.dont_write_bytecode = True  # the tests' import hook instruments what runpy compiles and would cache
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        with output.open("wb") as file:
            for number in (1, 2):
                os.dup2(file.fileno(), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.chdir(folder)
        os.environ.update(environment or {})
        sys.argv = ["anystyle", *words]
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False, errors="backslashreplace")  # as Python's own
        signal.signal(signal.SIGINT, signal.default_int_handler)
        main()
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else int(bool(code)))


def ended(child: int, seconds: float) -> int | None:
    """The exit status of a process, negative after a signal; ``None`` if it runs longer, and then it is killed."""
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    kill(child)
    return None


def kill(child: int) -> None:
    """Kill a process and all that it started, and wait for it."""
    with suppress(ProcessLookupError, PermissionError):  # it may not lead a group yet
        os.killpg(child, signal.SIGKILL)
    with suppress(ProcessLookupError):
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
