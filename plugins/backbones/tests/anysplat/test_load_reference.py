"""``load_reference``: a state dict in the original layout, whatever its values, is the published network."""

import re
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import save_file
from torch import Tensor

from anystyle.pipeline.weights import load_reference
from anystyle.stylizer import Stylizer
from anystyle.testing.oracle import fill_named, smooth_image
from anystyle.types import Gaussians, Scene, StyleEmbedding, Views
from tests.support import anysplat_reference as reference
from tests.support.oracle import golden

FILE = golden("golden_e2e_tiny")
CASE = FILE["tiny"]["tiny_v3_56x84"]
VOXEL = CASE["voxel_size"]
OPTIONS = [f"backbone.voxel_size={VOXEL}"]
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


def inputs() -> tuple[Views, StyleEmbedding]:
    index, shape = re.fullmatch(r"IMG\((\d+),\[(.*)\]\)", CASE["inputs"]["images"]).groups()
    row = int(re.search(r"in\((\d+),", CASE["inputs"]["z"]).group(1))
    vector = reference.style_vector(row)
    return Views(smooth_image(int(index), [int(side) for side in shape.split(",")])), StyleEmbedding(vector, vector)


def run(stylizer: Stylizer) -> tuple[Scene, Gaussians]:
    views, embedding = inputs()
    with torch.no_grad():
        scene = stylizer.encode(views)
        return scene, stylizer.restyle(scene, embedding)


def test_without_a_style_branch_it_is_the_reconstruction_whatever_the_style() -> None:
    state = {f"encoder.{key}": tensor for key, tensor in checkpoint("unstyled").items()}
    stylizer = load_reference(state, overrides=OPTIONS)
    scene, styled = run(stylizer)
    unstyled = stylizer.unstyled(scene)
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
    from anystyle.style_encoders.long_clip import LongClip

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


@pytest.mark.parametrize(
    ("gone", "told"),
    [
        ("aggregator_injection.frame_blocks.2.norm1.bias", r"1 missing \(aggregator_inj.*placement=full"),
        ("aggregator.camera_token", r"has no aggregator\.camera_token; it is not AnySplat's"),
    ],
)
def test_what_is_missing_is_named(gone: str, told: str) -> None:
    state = checkpoint("agg")
    del state[gone]
    with pytest.raises(ValueError, match=told) as caught:
        load_reference(state)
    assert "\n" not in str(caught.value)


def test_another_models_checkpoint_is_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match="not AnySplat's or AnyStyle's"):
        load_reference({"visual.proj": torch.zeros(2)})
    with pytest.raises(ValueError, match="not AnySplat's or AnyStyle's"):
        load_reference({})
    with pytest.raises(FileNotFoundError, match=r"there is no weights file nowhere\.ckpt"):
        load_reference("nowhere.ckpt")
