"""``load_reference``: a state dict in the original layout, whatever its values, is the published network."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from safetensors.torch import save_file
from torch import Tensor

import anysplat_reference as reference
from anystyle.inference.weights import load_reference
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, StyleEmbedding, Views
from oracle import assert_matches, fill_named, golden, smooth_image

FILE = golden("golden_e2e_tiny")
CASE = FILE["tiny"]["tiny_v3_56x84"]
VOXEL = CASE["voxel_size"]
OPTIONS = [f"backbone.voxel_size={VOXEL}"]
# Rows of the golden, and the attributes that are styled there.
MODES = {
    "none": ("color",),
    "colors-rotations": ("rotation", "color"),
    "no-pos": ("opacity", "scale", "rotation", "color"),
}
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
    index, shape = re.fullmatch(r"IMG\((\d+),\[(.*)\]\)", CASE["inputs"]["images"]).groups()  # type: ignore[union-attr]
    row = int(re.search(r"in\((\d+),", CASE["inputs"]["z"]).group(1))  # type: ignore[union-attr]
    vector = reference.style_vector(row)
    return Views(smooth_image(int(index), [int(side) for side in shape.split(",")])), StyleEmbedding(vector, vector)


def run(stylizer: Stylizer) -> tuple[Scene, Gaussians]:
    views, embedding = inputs()
    with torch.no_grad():
        scene = stylizer.encode(views)
        return scene, stylizer.restyle(scene, embedding)


def check_gaussians(scene: Scene, gaussians: Gaussians, record: Mapping[str, Any]) -> None:
    """Statistics over all, then samples found by the voxel they stand for."""
    assert scene.clusters is not None
    assert int(scene.clusters.valid.sum()) == pytest.approx(record["n_voxels"], rel=1e-3)
    assert list(gaussians.harmonics[0].mT.shape[1:]) == record["harmonics_shape"][1:]
    found = {
        "means": ("mean", gaussians.means[0]),
        "scales": ("scale", gaussians.scales[0]),
        "rotations_xyzw": ("rot_xyzw", gaussians.rotations[0].roll(-1, -1)),
        "opacities": ("opacity", gaussians.opacities[0][:, None]),
        "harmonics_dc": ("dc", gaussians.harmonics[0, :, 0]),
    }
    cells = (scene.geometry.points(0.0)[0].flatten(0, 2) / VOXEL).round().long()
    for name, (short, values) in found.items():
        for statistic, expected in record["stats"][name].items():
            power = values.double().mean(0) if statistic == "mean" else values.double().square().mean(0).sqrt()
            np.testing.assert_allclose(power.numpy(), expected, rtol=1e-4, atol=1e-4 * np.max(np.abs(expected)))
        for sample in record["samples"]:
            row = scene.clusters.index[0][(cells == torch.tensor(sample["voxel"])).all(-1)][0]
            expected = np.atleast_1d(sample[short])
            np.testing.assert_allclose(values[row].numpy(), expected, rtol=1e-3, atol=2e-4, err_msg=name)
    assert gaussians.harmonics[0].norm().item() == pytest.approx(record["stats"]["harmonics_l2"], rel=1e-4)


@pytest.mark.parametrize(("variant", "prefix"), [("head", "model.encoder."), ("agg", "")])
def test_styled_networks_compute_what_the_published_ones_do(variant: str, prefix: str) -> None:
    state = {prefix + key: tensor for key, tensor in checkpoint(variant).items()}
    stylizer = load_reference(state, overrides=[*OPTIONS, "branch.styled=[color]"])
    assert (stylizer.branch.aggregator is None) is (variant == "head")
    views, embedding = inputs()
    scene = stylizer.encode(views)
    assert_matches(scene.geometry.depth, {**CASE["base"]["depth"], "shape": [1, 3, 56, 84]}, atol=1e-4)
    assert stylizer.branch.styled == MODES["none"]
    for mode, styled in MODES.items():
        stylizer.branch.styled = styled
        check_gaussians(scene, stylizer.restyle(scene, embedding), CASE[f"{variant}/{mode}"]["gaussians"][0])


def test_without_a_style_branch_it_is_the_reconstruction_whatever_the_style() -> None:
    state = {f"encoder.{key}": tensor for key, tensor in checkpoint("unstyled").items()}
    stylizer = load_reference(state, overrides=OPTIONS)
    scene, styled = run(stylizer)
    check_gaussians(scene, styled, CASE["unstyled"]["gaussians"][0])
    unstyled = stylizer.unstyled(scene)
    for name in ("means", "rotations", "scales", "opacities", "harmonics"):
        assert torch.equal(getattr(unstyled, name), getattr(styled, name)), name


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


def test_tensors_of_the_right_type_are_not_copied() -> None:
    state = checkpoint("agg")
    stylizer = load_reference(state)
    given = {tensor.data_ptr() for tensor in state.values()}
    own = [*stylizer.backbone.parameters(), *stylizer.branch.parameters()]
    assert [tensor for tensor in own if tensor.data_ptr() not in given] == []
    assert not any(parameter.requires_grad for parameter in stylizer.parameters())
    assert not any(module.training for module in stylizer.modules())


def test_half_precision_parts_are_brought_to_full() -> None:
    state = {key: t.bfloat16() if key.startswith("aggregator.") else t for key, t in checkpoint("head").items()}
    stylizer = load_reference(state, overrides=OPTIONS)
    assert {parameter.dtype for parameter in stylizer.parameters()} == {torch.float32}
    key = "aggregator.frame_blocks.3.mlp.fc1.weight"
    assert torch.equal(stylizer.backbone.aggregator.frame_blocks[3].mlp.fc1.weight, state[key].float())  # type: ignore[index, union-attr]


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


def test_without_the_text_encoder_only_texts_are_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("ANYSTYLE_WEIGHTS", str(tmp_path))
    stylizer = load_reference(checkpoint("head"), overrides=OPTIONS)
    with pytest.raises(FileNotFoundError, match=r"longclip_b32.*longclip-B-32\.pt.*ANYSTYLE_WEIGHTS"):
        stylizer.embed(text="red")


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        ({"gone": "gaussian_param_head.input_merger.0.weight"}, r"1 missing \(gaussian_param_head\.input_merger"),
        ({"gone": "aggregator_injection.frame_blocks.2.norm1.bias"}, r"1 missing \(aggregator_inj.*placement=full"),
        ({"extra": "aggregator.unknown.weight"}, r"1 unexpected \(aggregator\.unknown\.weight\)"),
        ({"misshapen": "camera_head.token_norm.weight"}, r"1 misshapen \(camera_head\.token_norm\.weight is \[3\]"),
        ({"gone": "aggregator.camera_token"}, r"has no aggregator\.camera_token; it is not AnySplat's"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_named(damage: dict[str, str], told: str) -> None:
    state = checkpoint("agg")
    for what, key in damage.items():
        if what == "gone":
            del state[key]
        else:
            state[key] = torch.zeros(3)
    with pytest.raises(ValueError, match=told) as caught:
        load_reference(state)
    assert "\n" not in str(caught.value)


def test_a_head_checkpoint_is_not_a_full_model() -> None:
    with pytest.raises(ValueError, match=r"missing \(aggregator_injection.*trained with placement=head"):
        load_reference(checkpoint("head"), overrides=["placement=full"])
    with pytest.raises(ValueError, match=r"unexpected \(aggregator_injection.*trained with placement=full"):
        load_reference(checkpoint("agg"), overrides=["placement=head"])


def test_another_models_checkpoint_is_refused_in_one_line() -> None:
    with pytest.raises(ValueError, match="not AnySplat's or AnyStyle's"):
        load_reference({"visual.proj": torch.zeros(2)})
    with pytest.raises(ValueError, match="not AnySplat's or AnyStyle's"):
        load_reference({})
    with pytest.raises(FileNotFoundError, match=r"there is no weights file nowhere\.ckpt"):
        load_reference("nowhere.ckpt")
