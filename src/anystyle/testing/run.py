"""Running all that a kind of plugin promises."""

import importlib
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import base_of, catalog, kind_named
from anystyle.testing import declaration, system
from anystyle.testing.check import Check, Outcome, report, run_checks
from anystyle.testing.inputs import runtime
from anystyle.testing.subject import Subject
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector

COMPOSED = ("backbone", "placement", "injector")


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread: what is checked is so small that threads wait for each other more than they work."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def checks(kind: str) -> tuple[Check, ...]:
    """What a kind of plugin promises, as functions of a :class:`~anystyle.testing.subject.Subject`.

    Raises:
        PluginError: There is no such kind.
    """
    kind_named(kind)
    return importlib.import_module(f"anystyle.testing.{kind}").CHECKS


def subject(kind: str, cls: type, options: Mapping[str, Any]) -> Subject[Any]:
    """A class with the options and the runtime arguments that it is checked with."""
    known = runtime()
    return Subject(cls, options, {name: known[name] for name in KINDS[kind].runtime if name in known})


def run(kind: str, cls: type, options: Mapping[str, Any] | None = None) -> list[Outcome]:
    """Check a class against the contract of its kind, and together with the built-in plugins it meets.

    The options of its constructor are by default those that its ``example`` gives.

    Raises:
        PluginError: There is no such kind.
        ValueError: The class does not inherit from the kind's contract.
    """
    base = base_of(kind)
    if not issubclass(cls, base):
        raise ValueError(f"{cls.__name__} is no {kind}; make it inherit from {base.__module__}.{base.__qualname__}")
    with tempfile.TemporaryDirectory() as folder, one_thread():
        chosen = declaration.example(cls, Path(folder)) if options is None else options
        tested = subject(kind, cls, chosen)
        outcomes = run_checks(checks(kind), tested)
        if kind in COMPOSED and all(outcome.status == "passed" for outcome in outcomes):
            for label, composed in _compositions(kind, tested, Path(folder)):
                outcomes += run_checks(system.checks(label), composed)
        return outcomes


def run_named(kind: str, name: str) -> list[Outcome]:
    """Check a plugin of the catalog: its declaration first, then what :func:`run` checks.

    Raises:
        PluginError: The catalog lists no such kind or name.
    """
    if not catalog().declarations(kind, name):
        catalog().find(kind, name)
    with tempfile.TemporaryDirectory() as folder:
        declared = declaration.Declaration(kind, name, Path(folder))
        outcomes = run_checks(declaration.CHECKS, declared)
        broken = [outcome for outcome in outcomes if outcome.status == "failed" and outcome.check.needed]
        if broken:
            reason = f"needs what '{broken[0].check.name}' promises"
            return outcomes + [Outcome(check, "skipped", given=reason) for check in checks(kind)]
        return outcomes + run(kind, declared.plugin.load(), declared.options)


def assert_contract(kind: str, cls: type, **options: Any) -> None:
    """Fail with a report of all that is wrong, in plain words; for tests of plugins.

    Args:
        kind: A kind of plugin.
        cls: The class.
        options: Of its constructor; none for what its ``example`` says.

    Raises:
        AssertionError: The contract is broken, or cannot be checked on this machine.
    """
    outcomes = run(kind, cls, options or None)
    skipped = [outcome for outcome in outcomes if outcome.status == "skipped"]
    failures = report(outcomes)
    if failures:
        raise AssertionError(f"{cls.__name__} breaks the contract of a {kind}\n{failures}")
    if skipped:
        raise AssertionError(f"{cls.__name__}: {skipped[0].given}")


def _compositions(kind: str, tested: Subject[Any], folder: Path) -> list[tuple[str, system.Composition]]:
    # With the built-in placements, and beside those with the smallest backbone and injector there are.
    placements = {} if kind == "placement" else _built_in("placement", folder)
    base = system.Composition(
        subject("backbone", ToyBackbone, ToyBackbone.example(folder)),
        tested,
        subject("injector", ToyInjector, ToyInjector.example(folder)),
    )
    if kind == "placement":
        return [("together with other plugins", base)]
    return [
        (f"placement {name}", replace(base, placement=placement, **{kind: tested}))
        for name, placement in placements.items()
    ]


def _built_in(kind: str, folder: Path) -> dict[str, Subject[Any]]:
    rows = [row for row in catalog() if row.kind == kind and row.project == "anystyle" and row.root is None]
    return {row.name: subject(kind, row.load(), declaration.example(row.load(), folder)) for row in rows}
