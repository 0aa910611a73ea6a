"""Published checkpoints: names, and strict loading."""

import hashlib
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from anystyle.contracts import Backbone
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle_backbones.published import renamed
from anystyle_backbones.styl3r import Styl3r, keys
from tests.support import styl3r_reference as reference
from tests.support.refusals import raises_line

CHECKPOINTS = keys.Styl3rCheckpoints()
State = dict[str, Tensor]


def fresh() -> Styl3r:
    torch.manual_seed(3)
    return Styl3r(**reference.TINY)


def lightning() -> State:
    return {f"encoder.{name}": tensor for name, tensor in reference.tiny_weights().items()}


@pytest.mark.parametrize("network", ["tiny", "released"])
def test_names_are_the_published_ones(network: str) -> None:
    record = reference.record()[network]
    shapes = reference.shapes(network)
    lines = "\n".join(f"{name} {'x'.join(map(str, shape))}" for name, shape in sorted(shapes.items()))
    assert hashlib.sha256(lines.encode()).hexdigest() == record["keys_sha256"]
    with torch.device("meta"):
        own = Styl3r(**reference.TINY if network == "tiny" else {}).state_dict()
    names = keys.published_names(own)
    aliases = {name for name in shapes if renamed(name, keys.SECOND) != name}
    unused = {name for name in shapes if keys.UNUSED.search(name)}
    assert sorted([*names.values(), *aliases, *unused]) == sorted(shapes)
    assert len(aliases) == 20 and len(unused) == 22
    assert unused == set(reference.record()["tiny"]["unused"])
    for key, name in names.items():
        assert own[key].numel() == torch.Size(shapes[name]).numel(), name
    sizes = {name: torch.Size(shape).numel() for name, shape in shapes.items() if name not in aliases}
    assert len(shapes) == record["n_keys"] and sum(sizes.values()) == record["n_params"]


def test_the_published_size() -> None:
    with torch.device("meta"):
        backbone = build(Backbone, compose("stylize", ["model=styl3r"]).backbone)
    assert len(keys.published_names(backbone.state_dict())) == 1753
    found = keys.options_of(
        {name: torch.empty(shape, device="meta") for name, shape in reference.shapes("released").items()}
    )
    node = compose("stylize", ["model=styl3r"]).backbone
    for option, value in found.items():
        assert node[option] == (list(value) if isinstance(value, tuple) else value), option


def without(name: str) -> Callable[[State], State]:
    return lambda state: {key: tensor for key, tensor in state.items() if key != f"encoder.{name}"}


def changed(name: str, tensor: Tensor) -> Callable[[State], State]:
    return lambda state: state | {f"encoder.{name}": tensor}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed("lpips.weight", torch.zeros(1)), r"1 keys that are not Styl3R's \(lpips\.weight\)"),
        (changed("structure_builder.weight", torch.zeros(1)), "another network of Styl3R's repository"),
        (without(keys.MARKS[0]), "has no token_stylizer.dec_blocks.0.cross_attn.projq.weight"),
        (
            changed("downstream_head2.dpt.scratch.layer_rn.3.weight", torch.zeros(16, 20, 3, 3)),
            "has downstream_head2.dpt.scratch.layer4_rn.weight under two names",
        ),
    ],
)
def test_what_is_not_the_file_is_refused_in_one_line(change: Callable[[State], State], message: str) -> None:
    with raises_line(ValueError, match=message):
        fresh().load_reference(change(lightning()))
