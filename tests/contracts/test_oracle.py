"""The hash fill and its records: what a stranger makes an oracle with."""

import json

import pytest
import torch
from torch import nn

from anystyle.testing.oracle import assert_matches, fill_named, record, smooth_image, uniform
from tests.support.oracle import golden

RULES = [[r"^2\.bias$", {"center": [1.0, 2.0], "half": 0.5}], [r"^2\.weight$", {"scale": 0.5}]]


def network(eps: float = 1e-5) -> nn.Sequential:
    layers = nn.Sequential(nn.Linear(6, 8), nn.LayerNorm(8, eps=eps), nn.Linear(8, 2))
    layers.load_state_dict(fill_named(layers.state_dict(), RULES))
    return layers


def test_the_hash_is_that_of_the_goldens():
    for name in ("golden_styl3r", "golden_stylos", "golden_da3"):
        check = golden(name)["hash_check"]
        assert uniform(check["n"], check["i"]).tolist() == check["u"]


def test_a_record_survives_json_and_finds_a_mistake():
    given = smooth_image(3, (2, 3, 14, 21)).unflatten(-1, (-1, 3)).flatten(-2)[..., :6]
    stored = json.loads(json.dumps(record(network()(given))))
    assert_matches(network()(given), stored)
    for result in (network(eps=1e-3)(given), network()(given).flip(-1), network()(given)[:1]):
        with pytest.raises(AssertionError):
            assert_matches(result, stored)


def test_a_fill_depends_on_names_and_not_on_their_order():
    shapes = {"a.weight": torch.empty(3, 4), "b.gamma": torch.empty(5), "c": torch.empty(2, dtype=torch.long)}
    filled, turned = fill_named(shapes), fill_named(dict(reversed(shapes.items())))
    assert all(torch.equal(filled[name], turned[name]) for name in shapes)
    assert not torch.equal(filled["a.weight"], fill_named(shapes, offset=1)["a.weight"])
    assert filled["b.gamma"].min() >= 0.25 and filled["b.gamma"].max() < 0.75 and not filled["c"].any()
    ruled = fill_named(shapes, [["c", {"range": [5.0, 6.0]}], ["b", {"const": 2.0}]])
    assert torch.equal(ruled["b.gamma"], torch.full((5,), 2.0))
