"""Every plugin of the catalog, those of third parties too, keeps what its kind promises."""

import importlib

import pytest

from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import catalog
from anystyle.testing import assert_contract, report, run_named
from anystyle.testing.run import checks, run

PLUGINS = [(kind, name) for kind in KINDS for name in catalog().names(kind)]


def _toy(kind):
    name = "Toy" + "".join(word.capitalize() for word in kind.split("_"))
    return getattr(importlib.import_module(f"anystyle.testing.toy.{kind}"), name)


@pytest.mark.parametrize(("kind", "name"), PLUGINS, ids=[f"{kind}-{name}" for kind, name in PLUGINS])
def test_contract(kind, name, any_weights):
    outcomes = run_named(kind, name)
    assert not report(outcomes), report(outcomes)
    skipped = [outcome.given for outcome in outcomes if outcome.status == "skipped"]
    if skipped:
        pytest.skip(skipped[0])


@pytest.mark.parametrize("kind", KINDS)
def test_smallest_plugin_keeps_its_contract(kind):
    outcomes = run(kind, _toy(kind))
    assert all(outcome.status == "passed" for outcome in outcomes), report(outcomes)


@pytest.mark.parametrize("kind", KINDS)
def test_every_promise_is_said_in_words(kind):
    names = [check.name for check in checks(kind)]
    assert len(set(names)) == len(names) > 1
    for check in checks(kind):
        assert check.about.endswith(".")
        assert check.about != check.name


def test_a_report_of_all_that_is_wrong_fails_the_test_of_a_plugin():
    class Broken(_toy("placement")):
        def select(self, sites):
            return list(sites)

    with pytest.raises(AssertionError) as caught:
        assert_contract("placement", Broken)
    lines = str(caught.value).splitlines()
    assert lines[0] == "Broken breaks the contract of a placement"
    assert lines[1] == "FAILED  selects sites of the backbone"
    assert [line.split()[0] for line in lines[2:]] == ["given", "expected", "change"]
    with pytest.raises(ValueError, match=r"Broken is no loss; make it inherit from anystyle\.contracts\.Loss"):
        assert_contract("loss", Broken)


def test_what_this_machine_lacks_is_no_success():
    class Absent(_toy("placement")):
        def __init__(self):
            raise ImportError('it needs foo: pip install "acme[foo]"')

    with pytest.raises(AssertionError, match="Absent: it cannot be checked here: it needs foo"):
        assert_contract("placement", Absent)
