"""``load_reference``: a state dict in the original layout, whatever its values, is the published network."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import save_file
from torch import Tensor

from anystyle.pipeline.weights import load_reference
from anystyle.testing.oracle import fill_named
from anystyle.types import StyleEmbedding, Views
from tests.support import anysplat_reference as reference
from tests.support.oracle import golden, image

FILE = golden("golden_e2e_tiny")
CASE = FILE["tiny"]["tiny_v3_56x84"]
OPTIONS = [f"backbone.voxel_size={CASE['voxel_size']}"]
STYLE = ("aggregator_injection.", "gaussian_param_head_style.", "text_adapter.")


def checkpoint(variant: str, offset: int = 0) -> dict[str, Tensor]:
    """The hash-filled checkpoint of a variant, its keys without a prefix."""
    dropped = {"unstyled": STYLE, "head": STYLE[:1], "agg": ()}[variant]
    shapes = {
        key: torch.empty(shape, device="meta")
        for key, shape in FILE["tiny"]["keys"].items()
        if not key.startswith(tuple(dropped))
    }
    return fill_named(shapes, FILE["fill"]["rules"], offset)


@torch.no_grad()
def test_without_a_style_branch_it_is_the_reconstruction_whatever_the_style() -> None:
    state = {f"encoder.{key}": tensor for key, tensor in checkpoint("unstyled").items()}
    stylizer, vector = load_reference(state, overrides=OPTIONS), reference.style_vector()
    scene = stylizer.encode(Views(image(CASE["inputs"]["images"])))
    styled, unstyled = stylizer.restyle(scene, StyleEmbedding(vector, vector)), stylizer.unstyled(scene)
    for name in ("means", "rotations", "scales", "opacities", "harmonics"):
        assert torch.equal(getattr(unstyled, name), getattr(styled, name)), name


@pytest.mark.slow
def test_other_seeds_and_files_give_other_networks(tmp_path: Path) -> None:
    """What a file holds is what runs: nothing is taken from elsewhere, and no tensor is left as initialised."""
    state = checkpoint("agg", offset=77)
    save_file({f"model.encoder.{key}": tensor for key, tensor in state.items()}, tmp_path / "agg.safetensors")
    lightning = {
        "state_dict": {f"model.encoder.{key}": tensor for key, tensor in state.items()},
        "optimizer_states": [{"state": {0: {"exp_avg": torch.ones(3)}}}],
        "hyper_parameters": OmegaConf.create({"model": {"cond_type": "agg_injection_clip"}}),
    }
    torch.save(lightning, tmp_path / "agg.ckpt")
    from_state = load_reference(state, overrides=OPTIONS).state_dict()
    other = load_reference(checkpoint("agg"), overrides=OPTIONS).state_dict()
    for file in ("agg.safetensors", "agg.ckpt"):
        from_file = load_reference(tmp_path / file, overrides=OPTIONS).state_dict()
        assert from_file.keys() == from_state.keys()
        for key, tensor in from_state.items():
            assert torch.equal(from_file[key], tensor), key
        assert not any(torch.equal(tensor, other[key]) for key, tensor in from_state.items())


def test_the_text_adapter_comes_from_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from anystyle_backbones.long_clip import LongClip

    torch.manual_seed(0)
    small = {**LongClip.example(tmp_path), "dim": 512}
    overrides = [f"style_encoder.{name}={value}" for name, value in small.items()]
    state = checkpoint("head")
    clip = LongClip(**small).network.state_dict()
    stylizer = load_reference(state, style_encoder=clip, overrides=[*OPTIONS, *overrides])
    encoder = stylizer.style_encoder
    assert isinstance(encoder, LongClip) and encoder.adapter is not None
    assert torch.equal(encoder.adapter.mlp[2].weight, state["text_adapter.mlp.2.weight"])
    expected = encoder.adapter(encoder.features([template.format("red") for template in encoder.templates])).mean(0)
    torch.testing.assert_close(stylizer.embed(text="red").vector[0], expected / expected.norm())
