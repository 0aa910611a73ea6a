"""Every plugin of the catalog, third parties' included, keeps the contract of its kind."""

import importlib
from functools import cache
from itertools import product

import pytest

from anystyle.branch import StyleBranch
from anystyle.errors import MissingExtra, UserError
from anystyle.io.checkpoint import load_strictly
from anystyle.placements import Full, Head
from anystyle.registry.catalog import base_of, catalog, kinds
from anystyle.testing import assert_contract, composition, subject
from anystyle.testing.composition import Composition
from anystyle.testing.run import promises, promises_in
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector
from tests.contracts.mutants import NeedsCameras

PAIRS = list(product(catalog().names("placement"), catalog().names("injector")))
SMOKE = [("color", "zero_conv"), ("full", "zero_conv"), ("head", "zero_conv")]
"""What each backbone is composed with in the default suite; all pairs meet on the toy."""


def toy(kind):
    """The smallest plugin of a kind."""
    package = base_of(kind).__module__.partition(".")[0]
    name = "Toy" + "".join(word.capitalize() for word in kind.split("_"))
    return getattr(importlib.import_module(f"{package}.testing.toy.{kind}"), name)


@cache
def plugin_under_test(kind, name):
    return subject(kind, toy(kind) if name == "toy" else catalog().find(kind, name).load())


def named(cases):
    return [pytest.param(*case, id="-".join(getattr(part, "__name__", part) for part in case)) for case in cases]


@pytest.mark.parametrize(
    ("kind", "name", "promise"),
    named((kind, name, each) for kind in kinds() for name in catalog().names(kind) for each in promises(kind)),
)
def test_plugin(kind, name, promise, any_weights):
    promise(plugin_under_test(kind, name))


@cache
def composed(*names):
    return Composition(*map(plugin_under_test, ("backbone", "placement", "injector"), names))


def combinations():
    """Every placement with every injector, on the toy backbone and, but for a few, slowly on each of the catalog."""
    for backbone in ("toy", *catalog().names("backbone")):
        for pair in PAIRS:
            marks = [] if backbone == "toy" or pair in SMOKE else [pytest.mark.slow]
            yield pytest.param((backbone, *pair), id="-".join((backbone, *pair)), marks=marks)


@pytest.mark.parametrize("promise", promises_in(composition), ids=lambda promise: promise.__name__)
@pytest.mark.parametrize("names", list(combinations()))
def test_composition(names, promise):
    promise(composed(*names))


@pytest.mark.parametrize("kind", kinds())
def test_smallest_plugin_keeps_its_contract(kind):
    assert_contract(kind, toy(kind))


def test_a_backbone_may_need_cameras():
    assert_contract("backbone", NeedsCameras)


@pytest.mark.parametrize("kind", kinds())
def test_every_promise_is_described(kind):
    assert all((promise.__doc__ or "").strip().endswith(".") for promise in promises(kind))


def test_a_broken_promise_says_what_is_wrong():
    class Broken(toy("placement")):
        """Selects a list."""

        def select(self, sites):
            return list(sites)

    with pytest.raises(AssertionError, match="from 8 sites, not a tuple of some"):
        assert_contract("placement", Broken)
    with pytest.raises(UserError, match=r"Broken is not a loss; make it inherit from anystyle\.contracts\.\w+\.Loss"):
        assert_contract("loss", Broken)


def test_what_this_machine_lacks_is_no_success():
    class Absent(toy("placement")):
        """Needs what is not there."""

        def __init__(self):
            raise MissingExtra('it needs foo: pip install "acme[foo]"')

    with pytest.raises(pytest.skip.Exception, match="it cannot be checked here: it needs foo"):
        assert_contract("placement", Absent)


def test_weights_of_a_head_do_not_load_into_a_full_model():
    backbone = ToyBackbone(dim=12, depth=2).freeze()

    def branch(placement):
        sites = placement.select(backbone.sites)
        return StyleBranch(backbone, sites=sites, make_injector=lambda site: ToyInjector(dim=site.dim, style_dim=4))

    head, full = branch(Head()), branch(Full())
    with pytest.raises(ValueError, match=r"head\.safetensors does not fit .*: \d+ missing \(aggregator\."):
        load_strictly(full, head.state_dict(), source="head.safetensors")
    with pytest.raises(ValueError, match=r"\d+ unexpected \(aggregator\."):
        load_strictly(head, full.state_dict(), source="full.safetensors")
