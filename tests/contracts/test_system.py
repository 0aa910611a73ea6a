"""Every backbone with every placement and every injector of the catalog."""

import itertools
from functools import cache

import pytest

from anystyle.branch import StyleBranch
from anystyle.io.checkpoint import load_strictly
from anystyle.placements.full import Full
from anystyle.placements.head import Head
from anystyle.registry.catalog import catalog
from anystyle.testing.check import report, run_checks
from anystyle.testing.declaration import example
from anystyle.testing.run import subject
from anystyle.testing.system import CHECKS, Composition
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.testing.toy.injector import ToyInjector

PRODUCT = list(itertools.product(*(catalog().names(kind) for kind in ("backbone", "placement", "injector"))))


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Subjects by kind and name, each made once: compositions share the backbone."""

    @cache
    def find(kind, name):
        cls = catalog().find(kind, name).load()
        return subject(kind, cls, example(cls, tmp_path_factory.mktemp(name)))

    return find


@pytest.mark.parametrize(("backbone", "placement", "injector"), PRODUCT, ids=["-".join(names) for names in PRODUCT])
def test_composition(backbone, placement, injector, found):
    composed = Composition(found("backbone", backbone), found("placement", placement), found("injector", injector))
    outcomes = run_checks(CHECKS, composed)
    assert not report(outcomes), report(outcomes)
    if outcomes[0].status == "skipped":
        pytest.skip(outcomes[0].given)


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
