"""Check a plugin against all that its kind promises, and say in plain words what is wrong."""

import argparse
import inspect
import sys
import textwrap
import time
import warnings
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from anystyle.commands._flags import new_parser, parse
from anystyle.commands._run import run, words_of
from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import PluginError, catalog

if TYPE_CHECKING:
    from anystyle.testing.check import Outcome

WIDTH = 100
"""Columns of the report."""


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle plugins check``."""
    words = new_parser(
        "plugins check",
        "Run the contract of a plugin, installed or not, and report all that is broken at once: what was "
        "given, what was expected, what to change. Exit status 0: all is kept; 1: it is not; 2: no such plugin.",
    )
    words.add_argument("kind", metavar="KIND", help="one of: " + ", ".join(KINDS))
    words.add_argument("name", metavar="NAME", help="a plugin of that kind")
    words.add_argument("--fix-hints", action="store_true", help="add the promise in full, and code that keeps it")
    return words


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``anystyle plugins check``; the exit status is 0 where every promise is kept, else 1."""
    arguments = parse(parser(), words_of(argv))
    kind, name = arguments.kind, arguments.name
    if not catalog().declarations(kind, name):
        catalog().find(kind, name)  # says what there is

    from anystyle.testing.run import run_named

    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcomes = run_named(kind, name)
    print("\n".join(_report(kind, name, outcomes, hints=arguments.fix_hints)))
    print(_summary(outcomes, time.perf_counter() - start))
    return 0 if all(outcome.status == "passed" for outcome in outcomes) else 1


def _report(kind: str, name: str, outcomes: Sequence["Outcome"], *, hints: bool) -> Iterator[str]:
    yield from (str(row) for row in catalog().declarations(kind, name))
    for outcome in outcomes:
        if outcome.status != "failed":
            continue
        yield ""
        yield f"BROKEN  {outcome.check.name}"
        yield from _field("given", outcome.given)
        yield from _field("expected", outcome.expected)
        yield from _field("change", outcome.change)
        if hints:
            yield from _field("promise", outcome.check.about)
            yield from _field("where", _place(kind, name))
            yield from _example(kind, outcome.check.see)
    yield ""


def _field(title: str, text: str) -> list[str]:
    words = " ".join(text.split())
    return textwrap.wrap(
        words,
        WIDTH,
        initial_indent=f"  {title:<10}",
        subsequent_indent=" " * 12,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _summary(outcomes: Sequence["Outcome"], seconds: float) -> str:
    count = {status: [item for item in outcomes if item.status == status] for status in ("passed", "failed", "skipped")}
    kept = len(count["passed"])
    parts = [f"{kept} promise{'s' * (kept != 1)} kept"]
    if count["failed"]:
        parts.append(f"{len(count['failed'])} broken")
    if count["skipped"]:
        parts.append(f"{len(count['skipped'])} not checked ({count['skipped'][0].given})")
    return f"{', '.join(parts)}, in {seconds:.1f} s"


def _place(kind: str, name: str) -> str:
    try:
        cls = catalog().find(kind, name).load()
        return f"{inspect.getsourcefile(cls)}, line {inspect.getsourcelines(cls)[1]}"
    except (PluginError, OSError, TypeError):
        return "its pyproject.toml and the module named there"


def _example(kind: str, see: str) -> Iterator[str]:
    """The code of the smallest plugin of the kind, or of the part of it that a promise is about."""
    import importlib

    module = importlib.import_module(f"anystyle.testing.toy.{kind}")
    shown = getattr(module, see or "Toy" + "".join(word.capitalize() for word in kind.split("_")))
    yield f"  example   {module.__name__} keeps it:"
    yield ""
    yield textwrap.indent(textwrap.dedent(inspect.getsource(shown)).rstrip(), " " * 12)


if __name__ == "__main__":
    run(lambda: sys.exit(main()))
