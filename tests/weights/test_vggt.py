"""VGGT's file as an initialisation: its values are taken over, all of them, and what it lacks is told."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from anystyle.pipeline.load import assemble
from anystyle.registry.compose import compose, override
from tests.support.weights_cases import small_checkpoint


def vggt() -> dict[str, Tensor]:
    """The file in miniature: AnySplat's names without a prefix, no Gaussian head, two heads that AnySplat drops."""
    state = {key: tensor for key, tensor in small_checkpoint(None, seed=3).items() if "gaussian_param_head" not in key}
    return state | {"point_head.norm.weight": torch.ones(4), "track_head.tracker.weight": torch.ones(4)}


def words(file: Path) -> list[str]:
    """Overrides for a training that starts from a file, of the miniature's size."""
    from anystyle_backbones.anysplat import AnySplat

    small = [override(f"backbone.{name}", value) for name, value in AnySplat.example(Path()).items()]
    weights = ["weights.branch=null", override("weights.backbone", str(file))]
    return ["~model", "backbone=anysplat", "style_encoder=tiny", *small, *weights]


def test_every_value_is_taken_over_and_the_gaussian_head_is_left_as_initialised(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = vggt()
    from anystyle_backbones.anysplat import keys

    save_file(state, tmp_path / "vggt.safetensors")
    start = compose("stylize", [*words(tmp_path / "vggt.safetensors"), "weights.backbone=null"])
    torch.manual_seed(5)
    untouched, _ = assemble(start)
    torch.manual_seed(5)
    stylizer, found = assemble(compose("stylize", words(tmp_path / "vggt.safetensors")))
    own, before = stylizer.backbone.state_dict(), untouched.backbone.state_dict()
    names = keys.backbone_names(own)
    taken = [key for key in own if not key.startswith("gaussian_head.")]
    left = [key for key in own if key.startswith("gaussian_head.")]
    used = {name for name in state if not name.startswith(("point_head.", "track_head."))}
    assert {names[key] for key in taken} == used - {"aggregator.patch_embed.mask_token"}
    for key in taken:
        assert torch.equal(own[key], state[names[key]].reshape(own[key].shape)), key
    assert sum(not torch.equal(own[key], before[key]) for key in taken) > len(taken) / 2
    for key in left:
        assert torch.equal(own[key], before[key]), key
    assert f"initialises {len(taken)} of the backbone's {len(own)} tensors" in caplog.text
    assert f"left as they were: the {len(left)} of its Gaussian head" in caplog.text
    assert found["backbone"]["file"] == "vggt.safetensors"


@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("camera_head.token_norm.weight", r"1 missing \(camera_head\.token_norm\.weight\)"),
        ("aggregator.global_blocks.2.ls1.gamma", r"1 missing \(aggregator\.global_blocks\.2\.ls1\.gamma\)"),
    ],
)
def test_a_file_that_lacks_a_value_is_refused(tmp_path: Path, key: str, told: str) -> None:
    state = vggt()
    del state[key]
    save_file(state, tmp_path / "vggt.safetensors")
    with pytest.raises(ValueError, match=told + ".*"):
        assemble(compose("stylize", words(tmp_path / "vggt.safetensors")))
