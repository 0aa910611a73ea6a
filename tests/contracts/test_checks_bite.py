"""Each promise of each contract is broken on purpose, and found; nothing else is."""

import importlib

import pytest

from anystyle.placements.full import Full
from anystyle.registry.builtin import KINDS
from anystyle.testing.check import report, run_checks
from anystyle.testing.run import checks, subject
from anystyle.testing.subject import Subject
from anystyle.testing.system import CHECKS as SYSTEM
from anystyle.testing.system import Composition


def changed(kind):
    return importlib.import_module(f"contracts.mutants.{kind}").CHANGED


PLUGINS = [
    pytest.param(kind, cls, broken, id=f"{kind}-{name.replace(' ', '_')}")
    for kind in KINDS
    for name, (cls, broken) in changed(kind).items()
]
COMPOSED = [
    pytest.param(backbone, injector, broken, id=name.replace(" ", "_"))
    for name, (backbone, injector, broken) in changed("system").items()
]


@pytest.mark.parametrize(("kind", "cls", "broken"), PLUGINS)
def test_broken_promise_is_found_and_no_other(kind, cls, broken):
    outcomes = run_checks(checks(kind), subject(kind, cls, {}))
    assert {outcome.check.name for outcome in outcomes if outcome.status == "failed"} == broken, report(outcomes)
    for outcome in outcomes:
        if outcome.status == "failed":
            told = (outcome.given, outcome.expected, outcome.change)
            assert all(text and "\n" not in text for text in told)


@pytest.mark.parametrize(("backbone", "injector", "broken"), COMPOSED)
def test_broken_composition_is_found(backbone, injector, broken):
    composed = Composition(Subject(backbone), Subject(Full), Subject(injector))
    outcomes = run_checks(SYSTEM, composed)
    assert {outcome.check.name for outcome in outcomes if outcome.status == "failed"} == broken, report(outcomes)


@pytest.mark.parametrize("kind", KINDS)
def test_every_promise_is_broken_by_some_mutant(kind):
    broken = set().union(*(names for _, names in changed(kind).values()))
    assert broken == {check.name for check in checks(kind)}


def test_every_promise_of_compositions_is_broken_by_some_mutant():
    broken = set().union(*(names for _, _, names in changed("system").values()))
    assert broken == {check.name for check in SYSTEM}
