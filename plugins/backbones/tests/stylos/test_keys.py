"""Published checkpoints: names, second names, and strict loading."""

import logging
import re
from pathlib import Path

import pytest
import torch
from torch import Tensor

from anystyle_backbones.stylos import Stylos, StylosStyle, keys
from tests.support import stylos_reference

CHECKPOINTS = keys.StylosCheckpoints()
MASK = "aggregator.patch_embed.mask_token"
CONFIGURED = {"dl3dv_geo": {}, "co3d_geo_frame_base": {"style_order": "frame"}} | {
    "co3d_geo_hybrid_base": {"style_order": "hybrid"}
}


def published(backbone: Stylos) -> dict[str, Tensor]:
    """The tensors of a file, under their first names."""
    state = backbone.state_dict()
    names = keys.backbone_names(state)
    mask = torch.zeros(1, backbone.aggregator.dim, device=next(iter(state.values())).device)
    found = {name: state[key] for key, name in names.items()} | {MASK: mask}
    return {n: t[:, :, None, None] if re.search(r"projects\.\d\.weight", n) else t for n, t in found.items()}


def aliases(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """What PyTorch's state dict names a second time."""
    second = {f"style_aggregator.{name}": state[name] for name in state if name.startswith("aggregator.")}
    patches = {name: name.partition(".")[2] for name in state if name.startswith(keys.PATCHES)}
    return second | {f"style_aggregator.{rest}": state[name] for name, rest in patches.items()}


@pytest.mark.parametrize("name", CONFIGURED)
def test_numbers_of_published_tensors(name: str) -> None:
    full = stylos_reference.record()["full"]
    record = full["other_configs"][name]
    with torch.device("meta"):
        state = published(Stylos(**CONFIGURED[name]))
    assert len(state) == record["n_keys"] and sum(map(Tensor.numel, state.values())) == record["n_params"]
    assert len(state | aliases(state)) == record["n_keys_with_aliases"]
    if name == "dl3dv_geo":
        assert (len(state), len(state | aliases(state))) == (1862, 3416)
        shapes = stylos_reference.expanded(full["keys"])
        assert {key: tensor.shape for key, tensor in state.items()} == {key: shapes[key].shape for key in shapes}
        branch = keys.branch_names(Stylos.make_branch(meta()).state_dict())
        parts = full["parts"]
        assert len(branch) == parts["style_aggregator"][0] + parts["style_gaussian_param_head"][0]
        assert set(branch.values()) <= state.keys()


def meta() -> Stylos:
    with torch.device("meta"):
        return Stylos()


@pytest.fixture(scope="module")
def small() -> Stylos:
    torch.manual_seed(0)
    return Stylos(**Stylos.example(Path()))


def encoder(**options: object) -> StylosStyle:
    return StylosStyle(**(StylosStyle.example(Path()) | {"native_resolution": 56} | options))


def lightning(state: dict[str, Tensor]) -> dict[str, Tensor]:
    whole = {f"model.encoder.{name}": tensor for name, tensor in (state | aliases(state)).items()}
    others = (
        "losses.4.net.enc_1.0.weight",
        "losses.5.clip_model.visual.proj",
        "model.encoder.distill_depth_head.norm.bias",
    )
    return whole | {name: torch.zeros(2) for name in others}


@pytest.mark.parametrize("form", ["bare", "hub", "second names alone", "lightning"])
def test_weights_survive_the_way_there_and_back(small: Stylos, form: str) -> None:
    state = published(small)
    firsts = {name: state[name] for name in state if not name.startswith("aggregator.")}
    given = {
        "bare": state,
        "hub": {f"encoder.{name}": tensor for name, tensor in state.items()},
        "second names alone": {f"encoder.{name}": tensor for name, tensor in (firsts | aliases(state)).items()},
        "lightning": lightning(state),
    }[form]
    torch.manual_seed(1)
    other, style = Stylos(**Stylos.example(Path())), encoder()
    branch = other.make_branch()
    other.load_reference(given)
    CHECKPOINTS.load("branch", branch, given)
    CHECKPOINTS.load("style_encoder", style, given)
    for key, tensor in small.state_dict().items():
        assert torch.equal(other.state_dict()[key], tensor), key
    for key, tensor in small.make_branch().state_dict().items():
        assert torch.equal(branch.state_dict()[key], tensor), key
    for key, tensor in small.embedder.patches.state_dict().items():
        assert torch.equal(style.patches.state_dict()[key], tensor), key


def test_second_names_must_be_the_same_tensors(small: Stylos) -> None:
    state = published(small)
    both = state | {name: tensor.clone() for name, tensor in aliases(state).items()}
    CHECKPOINTS.parts(both)
    both["style_aggregator.patch_embed.norm.bias"] = both["style_aggregator.patch_embed.norm.bias"] + 1
    with pytest.raises(ValueError, match=r"has aggregator\.patch_embed\.norm\.bias under two names"):
        CHECKPOINTS.parts(both)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("style_gaussian_param_head.input_merger.0.weight", r"1 unexpected \(style_gaussian_param_head\.input_merger"),
        ("style_gaussian_param_head.shallow_extractor.0.weight", "of the type crossattn"),
    ],
)
def test_what_no_configuration_has_is_refused(small: Stylos, name: str, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        small.load_reference(published(small) | {name: torch.zeros(2)})


def test_a_file_of_anysplat_is_refused(small: Stylos) -> None:
    state = {key: tensor for key, tensor in published(small).items() if not key.startswith(keys.STYLE)}
    with pytest.raises(ValueError, match="no style_aggregator"):
        CHECKPOINTS.config(state)


@pytest.mark.parametrize("variant", ["global", "frame", "hybrid", "demo"])
def test_a_file_says_which_network_it_is(variant: str, caplog: pytest.LogCaptureFixture) -> None:
    shapes = stylos_reference.tiny_shapes(variant)
    with caplog.at_level(logging.INFO):
        config = CHECKPOINTS.config(shapes)
    assert config["backbone.style_order"] == (variant if variant in ("frame", "hybrid") else "global")
    assert config["backbone.image_features"] == (variant == "demo")
    assert config["branch.published"] is True and config["style_encoder"] == "stylos"
    assert "assumed: backbone.style_taps=[0, 1, 2, 4] backbone.voxel_size=0.002" in caplog.text


def test_published_options(caplog: pytest.LogCaptureFixture) -> None:
    config = CHECKPOINTS.config(stylos_reference.expanded(stylos_reference.record()["full"]["keys"]))
    options = {name.removeprefix("backbone."): config[name] for name in config if name.startswith("backbone.")}
    with torch.device("meta"):
        plain, told = Stylos().state_dict(), Stylos(**options).state_dict()
    assert {key: tensor.shape for key, tensor in plain.items()} == {key: tensor.shape for key, tensor in told.items()}
    assert options["style_taps"] == (2, 5, 8, 11) and options["taps"] == (4, 11, 17, 23)
