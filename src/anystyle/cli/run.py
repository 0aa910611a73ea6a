"""Running a command: exit statuses, user errors in one line, tracebacks of bugs."""

import os
import signal
import sys
import threading
import traceback
import webbrowser
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from anystyle.errors import Terminated, UserError, one_line

FAILED, INTERRUPTED = 2, 130
_FULL = ("ANYSTYLE_TRACEBACK", "HYDRA_FULL_ERROR")


def run(command: Callable[[], Any]) -> None:
    """Run a command, and exit with its status.

    A user error prints one line to the standard error stream and exits with status 2, an interruption with 130. A bug
    shows its traceback, and so does every error where ``ANYSTYLE_TRACEBACK=1``.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _terminated)
    try:
        try:
            command()
            sys.stdout.flush()
        except Exception as error:
            if (ending := _signal_behind(error)) is not None:
                raise ending from None
            raise
    except KeyboardInterrupt:
        print("anystyle: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # The reader of the pipe, such as `head`, has closed it; Python would report that again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        text = message(error)
        if text is None or wants_traceback():
            name_plugin(error)
            raise
        print(f"anystyle: error: {text}", file=sys.stderr)
        sys.exit(FAILED)


def show(address: str) -> None:
    """Open an address in the browser where there is a display; nothing happens elsewhere."""
    if sys.platform != "linux" or {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        with suppress(webbrowser.Error, OSError):
            webbrowser.open(address)


def _terminated(number: int, frame: object) -> NoReturn:
    """Exit through Python's own cleanup, so that temporary files are removed."""
    print("anystyle: terminated", file=sys.stderr)
    raise Terminated(128 + number)


def _signal_behind(error: BaseException | None) -> BaseException | None:
    """What a signal raised, where a library that was interrupted has made an error of its own of it."""
    while error is not None and not isinstance(error, KeyboardInterrupt | Terminated):
        error = error.__cause__ or error.__context__
    return error


def wants_traceback() -> bool:
    """Whether the user asked for tracebacks of every error; ``ANYSTYLE_TRACEBACK=0`` takes precedence."""
    return os.environ.get(_FULL[0]) != "0" and any(os.environ.get(name) == "1" for name in _FULL)


def message(error: BaseException) -> str | None:
    """The one line for an error of the user's; ``None`` for a bug, whose traceback is shown."""
    if "omegaconf" in sys.modules:
        from anystyle.registry.compose import ERRORS, explain

        if isinstance(error, ERRORS):
            return explain(error)
    if isinstance(error, OSError) and (error.strerror or error.filename is not None):
        from anystyle.io.atomic import final

        at = error.filename and final(Path(str(error.filename)))  # whatever name it has while it is written
        return ": ".join(str(part) for part in (at, error.strerror) if part)
    if isinstance(error, UserError | FileNotFoundError):
        return one_line(error)
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
        return f"out of memory: {one_line(error) or 'use fewer views or a smaller size'}"
    return None


def name_plugin(error: BaseException) -> None:
    """Add a note to an error that came from a third party's package: of which plugin, and how to check its contract.

    It is the plugin of which the innermost object is that was at work; where none was, only the package is named.
    """
    from anystyle.registry.catalog import catalog, location_in

    rows = [row for row in catalog() if row.origin != "anystyle"]
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)][::-1]
    at_work = ((frame.f_globals.get("__name__"), type(frame.f_locals.get("self")).__module__) for frame in frames)
    raised = (_package(module) for modules in at_work for module in modules)
    package = next((name for name in raised if name in {_package(row.target) for row in rows}), None)
    if package is None:
        return
    location = location_in(error, package)
    plugins = {row.target.partition(":")[2]: row for row in rows if _package(row.target) == package}
    for cls in (cls for frame in frames for cls in type(frame.f_locals.get("self")).__mro__):
        if (plugin := plugins.get(cls.__qualname__)) and _package(cls.__module__) == package:
            check = f"`anystyle plugins check {plugin.kind} {plugin.name}` checks its contract"
            error.add_note(f"{plugin}{location}; {check}")
            return
    error.add_note(f"it was raised in the package {package}{location}")


def _package(module: object) -> str:
    return str(module).partition(":")[0].partition(".")[0]


def words_of(words: Sequence[str] | None) -> list[str]:
    """The words of a command line after the command."""
    return list(sys.argv[1:] if words is None else words)
