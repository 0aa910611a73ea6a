"""Errors that a user can cause, as one-line messages."""

import difflib
import importlib
from collections.abc import Collection, Iterable, Sequence
from typing import Any


class UserError(ValueError):
    """What was given, what was expected, what to do: one line, and no traceback on the command line."""


class MissingExtra(UserError, ImportError):
    """An optional dependency is not installed; the message names the extra that brings it."""


def of_extra(module: str, needs: str, extra: str) -> Any:
    """Import a module that an extra brings, or raise a MissingExtra that begins with ``needs``, as in "plots need"."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtra(f'{needs} {module.partition(".")[0]}: pip install "anystyle[{extra}]"') from error


class Terminated(SystemExit):
    """The exit after SIGTERM, which is nobody's error."""


def one_line(message: object) -> str:
    """A message of several lines as one."""
    return " ".join(str(message).split())


def listing(items: Sequence[object], most: int = 10) -> str:
    """Items in one line, the first ones where there are many."""
    shown = ", ".join(str(item) for item in items[:most])
    return shown + (f" and {len(items) - most} more" if len(items) > most else "")


def did_you_mean(word: str, words: Iterable[str]) -> str:
    """``Did you mean 'this'?`` with a leading space where a known word is near, else nothing."""
    near = difflib.get_close_matches(word, list(words), n=1, cutoff=0.65)
    return f" Did you mean '{near[0]}'?" if near else ""


def check_known(what: str, words: Iterable[str], known: Collection[str]) -> None:
    """Refuse words that are not among those known; see :func:`unknown`."""
    for word in words:
        if word not in known:
            raise UserError(unknown(what, word, known))


def unknown(what: str, word: str, words: Iterable[str]) -> str:
    """Say that no ``what`` has this name, with the nearest one and all there are."""
    known = sorted(words)
    return f"no {what} is named '{word}'.{did_you_mean(word, known)} Available: {', '.join(known) or 'none'}"
