"""A contract is a tuple of checks; a check is a plain function that raises :class:`ContractError`."""

import logging
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from inspect import getdoc
from pathlib import Path
from typing import Any, Literal

log = logging.getLogger(__name__)

LIBRARIES = frozenset({"torch", "jaxtyping", "beartype", "torchmetrics", "contextlib.py"})


class ContractError(AssertionError):
    """A promise that a plugin does not keep.

    Args:
        given: What the plugin did, with shapes and numbers.
        change: What its author can do about it.
        expected: What the contract asks for; empty where the promise that is checked says it.
    """

    def __init__(self, *, given: str, change: str, expected: str = "") -> None:
        super().__init__(f"given {given}; {f'expected {expected}; ' if expected else ''}{change}")
        self.given = given
        self.expected = expected
        self.change = change


class Unavailable(Exception):
    """A plugin cannot be checked on this machine; the message says what it lacks."""


@dataclass(frozen=True)
class Check:
    """One promise of a contract.

    Args:
        function: Raises where the promise is broken; its docstring says the promise in plain words.
        needed: Whether the checks after it make no sense where it fails.
        where: What it is checked together with, if it is checked several times.
        see: The class in ``anystyle.testing.toy`` that shows how it is kept; the plugin itself if empty.
    """

    function: Callable[[Any], None]
    needed: bool = False
    where: str = ""
    see: str = ""

    @property
    def name(self) -> str:
        """The promise in a few words."""
        words = self.function.__name__.replace("_", " ")
        return f"{words} ({self.where})" if self.where else words

    @property
    def about(self) -> str:
        """The promise in plain words."""
        return getdoc(self.function) or self.name


@dataclass(frozen=True)
class Outcome:
    """What one check found.

    Args:
        check: The promise.
        status: ``skipped`` where a check before it failed that it needs, or where this machine lacks something.
        given: What the plugin did; for a skipped check, why.
        expected: What the contract asks for.
        change: What its author can do about it.
        seconds: How long it took.
    """

    check: Check
    status: Literal["passed", "failed", "skipped"]
    given: str = ""
    expected: str = ""
    change: str = ""
    seconds: float = field(default=0.0, compare=False)


def expect(holds: bool, *, given: str, change: str, expected: str = "") -> None:
    """Raise a :class:`ContractError` unless a promise holds."""
    if not holds:
        raise ContractError(given=given, change=change, expected=expected)


@contextmanager
def attempt(what: str, *, change: str) -> Iterator[None]:
    """Turn whatever the plugin raises in the block into a :class:`ContractError` that says what was tried."""
    try:
        yield
    except (ContractError, Unavailable):
        raise
    except Exception as error:
        raise ContractError(given=f"{what} ended in {describe(error)}", expected="it to work", change=change) from error


@contextmanager
def refusal(change: str, *, unless: str = "") -> Iterator[None]:
    """Expect the block to raise a ValueError of one line.

    Args:
        change: What the plugin's author can do.
        unless: What the plugin did if the block raised nothing; empty where that is as good.
    """
    try:
        yield
    except ValueError as error:
        expect(
            bool(str(error)) and "\n" not in str(error),
            given=f"a ValueError that says {str(error)[:100]!r}",
            expected="one line: what was given, what was expected, what to do",
            change=change,
        )
    else:
        expect(not unless, given=unless, expected="a ValueError", change=change)


def describe(error: BaseException) -> str:
    """An error in one line, with the place in the plugin's code that it came from."""
    lines = str(error).strip().splitlines()
    first = lines[0] if lines else ""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _is_plugins(frame.filename)]
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {first[:300]}{where}"


def run_checks(checks: Sequence[Check], subject: object) -> list[Outcome]:
    """Run every check and collect what each found; after a failed one that the rest needs, the rest is skipped."""
    outcomes: list[Outcome] = []
    blocked = ""
    for check in checks:
        if blocked:
            outcomes.append(Outcome(check, "skipped", given=blocked))
            continue
        outcome = _run_one(check, subject)
        log.debug("%s: %s in %.2f s", check.name, outcome.status, outcome.seconds)
        outcomes.append(outcome)
        if outcome.status == "failed" and check.needed:
            blocked = f"needs what '{check.name}' promises"
        elif outcome.status == "skipped":
            blocked = outcome.given
    return outcomes


def report(outcomes: Sequence[Outcome]) -> str:
    """The failures in plain words, several lines each; empty where all is well."""
    lines: list[str] = []
    for outcome in outcomes:
        if outcome.status == "failed":
            lines.append(f"FAILED  {outcome.check.name}")
            lines += [
                f"  given     {outcome.given}",
                f"  expected  {outcome.expected}",
                f"  change    {outcome.change}",
            ]
    return "\n".join(lines)


def _run_one(check: Check, subject: object) -> Outcome:
    start = time.perf_counter()
    try:
        check.function(subject)
        return Outcome(check, "passed", seconds=time.perf_counter() - start)
    except Unavailable as error:
        return Outcome(check, "skipped", given=str(error))
    except ContractError as error:
        given, expected, change = error.given, error.expected, error.change
    except Exception as error:
        given, expected, change = f"it ended in {describe(error)}", "", "see the line named above"
    promise = " ".join(check.about.split())
    return Outcome(check, "failed", given, expected or promise, change, time.perf_counter() - start)


def _is_plugins(filename: str) -> bool:
    # Neither the checks themselves nor the libraries that call back are what the author has to change. An installed
    # plugin lies in site-packages like they do, so the libraries are named.
    path = Path(filename)
    return not filename.startswith("<") and path.parent != Path(__file__).parent and not LIBRARIES & set(path.parts)
