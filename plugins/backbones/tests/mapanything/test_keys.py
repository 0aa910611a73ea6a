"""The published checkpoint: names, and strict loading."""

import re
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from anystyle.geometry.harmonics import CONSTANT
from anystyle.pipeline.weights import load_reference
from anystyle.testing.oracle import smooth_image
from anystyle.types import Views
from anystyle_backbones.mapanything import MapAnything, keys
from tests.support import mapanything_reference as reference

GOLDEN = reference.record()
CHECKPOINTS = keys.MapAnythingCheckpoints()


def all_names() -> dict[str, Tensor]:
    """The tensors under every name that the published module has for them."""
    weights = reference.tiny_weights()
    return weights | {name: weights[keys.renamed(name, keys._SECOND)] for name in GOLDEN["tiny"]["second_names"]}


@pytest.mark.parametrize(("network", "options"), [("tiny", reference.TINY), ("full", {})])
def test_every_published_tensor_has_a_place_or_a_reason(network: str, options: dict[str, Any]) -> None:
    shapes, record = reference.shapes(network), GOLDEN[network]
    assert len(shapes) == record["n_keys"] and sum(map(Tensor.numel, shapes.values())) == record["n_params"]
    with torch.device("meta"):
        state = MapAnything(**options).state_dict()
    names = keys.backbone_names(state)
    unused = {name for name in shapes if any(re.match(pattern, name) for pattern in keys.UNUSED)}
    assert sorted([*names.values(), *unused]) == sorted(shapes)
    assert all(any(re.match(pattern, name) for name in shapes) for pattern in keys.UNUSED)
    assert {key.split(".")[0] for key in state.keys() - names} == {"gaussian_head"}
    for key, name in names.items():
        assert state[key].numel() == shapes[name].numel(), key


def test_options_read_off_shapes_are_the_constructor_s() -> None:
    found = CHECKPOINTS.config(reference.shapes("full"))
    defaults = {f"backbone.{name}": value for name, value in (MapAnything.__init__.__kwdefaults__ or {}).items()}
    assert found.pop("branch.sh_degree") == 0
    assert {name: defaults[name] for name in found} == found
    assert {"backbone.dim", "backbone.depth", "backbone.heads", "backbone.pose_hidden"} <= set(found)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"visual.proj": torch.zeros(1)}, r"1 keys that are not MapAnything 1\.1's \(visual\.proj\)"),
        ({"pose_head.extra": torch.zeros(1)}, r"1 unexpected \(pose_head\.extra\)"),
        ({"scale_token": None}, r"1 missing \(scale_token\)"),
        ({"dense_head.1.conv2.2.bias": torch.zeros(7)}, r"dense_head\.1\.conv2\.2\.bias"),
        (
            {keys.MARK: None},
            r"has no info_sharing\.self_attention_blocks\.0\.mlp\.w12\.weight: it is not MapAnything 1",
        ),
    ],
)
def test_loading_is_strict(change: dict[str, Tensor | None], message: str) -> None:
    state = {**reference.tiny_weights(), **change}
    with pytest.raises(ValueError, match=message) as caught:
        MapAnything(**reference.TINY).load_reference({key: value for key, value in state.items() if value is not None})
    assert "\n" not in str(caught.value)


def test_second_names_are_compared() -> None:
    state = all_names()
    assert len(state) == GOLDEN["tiny"]["n_names"] == GOLDEN["tiny"]["n_keys"] + len(GOLDEN["tiny"]["second_names"])
    one, other = (MapAnything(**reference.TINY) for _ in range(2))
    one.load_reference(reference.tiny_weights())
    other.load_reference({name: tensor.clone() for name, tensor in state.items()})
    for part in ("embedder", "aggregator", "geometry_head"):
        loaded = getattr(other, part).state_dict()
        assert all(torch.equal(tensor, loaded[key]) for key, tensor in getattr(one, part).state_dict().items())
    name = "dpt_feature_head.scratch.layer_rn.2.weight"
    with pytest.raises(ValueError, match="are one tensor, and differ; get the file again"):
        other.load_reference(state | {name: state[name] + 1})


def test_no_branch_is_published() -> None:
    with pytest.raises(ValueError, match="holds no style branch"):
        CHECKPOINTS.load("branch", torch.nn.Identity(), reference.tiny_weights())
    assert CHECKPOINTS.parts(reference.tiny_weights()) == {"backbone": False}


def test_a_checkpoint_becomes_a_stylizer_by_one_call(tmp_path: Path) -> None:
    save_file(reference.tiny_weights(), tmp_path / "model.safetensors")
    # What shapes do not tell of a size that is not published.
    own = ["backbone.taps=[-1,2,3,5]", "backbone.heads=4", "backbone.gaussian_hidden=16"]
    stylizer = load_reference(
        tmp_path / "model.safetensors", overrides=["backbone=mapanything", *own, "injector.hidden=8"]
    )
    assert not any(tensor.is_meta for tensor in stylizer.backbone.state_dict().values())
    with torch.no_grad():
        scene = stylizer.encode(Views(smooth_image(1, (1, 2, 3, 28, 42))))
        gaussians = stylizer.unstyled(scene)
    assert bool(gaussians.means.isfinite().all())
    # The Gaussian head, which the file lacks, has its initial values.
    expected = ((scene.views.images - 0.5) / CONSTANT).movedim(2, -1).flatten(1, 3)
    torch.testing.assert_close(gaussians.harmonics[:, :, 0], expected, rtol=0, atol=0.1)
