"""The published checkpoint: names, and strict loading."""

import re
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from anystyle.pipeline.weights import load_reference
from anystyle.testing.oracle import smooth_image
from anystyle.types import Views
from anystyle_backbones.worldmirror import WorldMirror, keys
from tests.support import worldmirror_reference as reference

GOLDEN = reference.record()
READ = {"nothing": set(), "lenses": {"ray_embed"}, "cameras": {"ray_embed", "pose_embed"}}
CHECKPOINTS = keys.WorldMirrorCheckpoints()


@pytest.mark.parametrize("known", ["nothing", "lenses", "cameras"])
@pytest.mark.parametrize(("network", "options"), [("tiny", reference.TINY), ("full", {})])
def test_every_published_tensor_has_a_place_or_a_reason(network: str, options: dict[str, Any], known: str) -> None:
    shapes, record = reference.shapes(network), GOLDEN[network]
    assert len(shapes) == record["n_keys"] and sum(map(Tensor.numel, shapes.values())) == record["n_params"]
    with torch.device("meta"):
        state = WorldMirror(**options, known=known).state_dict()
    names = keys.backbone_names(state)
    unused = {name for name in shapes if any(re.match(pattern, name) for pattern in keys.UNUSED)}
    assert set(names.values()) | unused == set(shapes)
    assert {name.split(".")[1] for name in unused & set(names.values())} == READ[known]
    assert all(any(re.match(pattern, name) for name in shapes) for pattern in keys.UNUSED)
    for key, name in names.items():
        assert state[key].numel() == shapes[name].numel(), key


def test_what_two_decoders_hold_twice_is_the_gaussian_decoder_alone() -> None:
    with torch.device("meta"):
        names = keys.backbone_names(WorldMirror(**reference.TINY).state_dict())
    twice = {name for name in names.values() if list(names.values()).count(name) > 1}
    assert twice and all(name.startswith("gs_head.") for name in twice)


def test_options_read_off_shapes_are_the_constructor_s() -> None:
    found = CHECKPOINTS.config(reference.shapes("full"))
    defaults = {f"backbone.{name}": value for name, value in (WorldMirror.__init__.__kwdefaults__ or {}).items()}
    assert found.pop("branch.sh_degree") == 0
    assert {name: defaults[name] for name in found} == found
    assert {"backbone.dim", "backbone.depth", "backbone.gaussian_hidden", "backbone.gaussian_channels"} <= set(found)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"visual.proj": torch.zeros(1)}, r"1 keys that are not WorldMirror's \(visual\.proj\)"),
        ({"cam_head.extra": torch.zeros(1)}, r"1 unexpected \(cam_head\.extra\)"),
        ({"cam_head.init_token": None}, r"1 missing \(cam_head\.init_token\)"),
        ({"gs_renderer.gs_head.2.bias": torch.zeros(13)}, r"gs_renderer\.gs_head\.2\.bias"),
    ],
)
def test_loading_is_strict(change: dict[str, Tensor | None], message: str) -> None:
    state = {**reference.tiny_weights(), **change}
    with pytest.raises(ValueError, match=message) as caught:
        WorldMirror(**reference.TINY).load_reference({key: value for key, value in state.items() if value is not None})
    assert "\n" not in str(caught.value)


def test_no_branch_is_published() -> None:
    with pytest.raises(ValueError, match="holds no style branch"):
        CHECKPOINTS.load("branch", torch.nn.Identity(), reference.tiny_weights())


def test_a_checkpoint_becomes_a_stylizer_by_one_call(tmp_path: Path) -> None:
    save_file(reference.tiny_weights(), tmp_path / "model.safetensors")
    # What shapes do not tell of a size that is not published.
    own = ["backbone.taps=[1,3,4,5]", "backbone.camera_heads=4", "backbone.voxel_size=0.05"]
    overrides = ["backbone=worldmirror", *own, "injector.hidden=8"]
    stylizer = load_reference(tmp_path / "model.safetensors", overrides=overrides)
    assert not any(tensor.is_meta for tensor in stylizer.backbone.state_dict().values())
    with torch.no_grad():
        scene = stylizer.encode(Views(smooth_image(1, (1, 2, 3, 28, 42))))
    assert bool(stylizer.unstyled(scene).means.isfinite().all())
