"""Published checkpoints: names, and strict loading."""

import pytest
import torch
from torch import Tensor

from anystyle.contracts import Backbone
from anystyle.pipeline.weights import load_reference
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.testing.oracle import smooth_image
from anystyle.types import Views
from anystyle_backbones.depth_anything import DepthAnything, keys
from tests.support import depth_anything_reference as reference
from tests.support.backbone_cases import tally

# Keys and parameters of the published modules: trunk, depth decoder, camera decoder, and the one Gaussian head.
PUBLISHED = {
    "small": {"backbone": (207, 22_059_008), "head": (62, 2_932_706), "cam_dec": (10, 1_188_105)},
    "base": {"backbone": (207, 86_583_296), "head": (62, 11_704_162), "cam_dec": (10, 4_735_497)},
    "large": {"backbone": (407, 304_373_760), "head": (62, 32_654_562), "cam_dec": (10, 8_411_145)},
    "giant": {
        "backbone": (675, 1_136_489_216),
        "head": (62, 35_540_194),
        "cam_dec": (10, 18_908_169),
        "gs_head": (66, 35_628_486),
    },
}
CHECKPOINTS = keys.DepthAnythingCheckpoints()


def preset(name: str) -> DepthAnything:
    with torch.device("meta"):
        return build(Backbone, compose("stylize", [f"backbone=depth_anything_{name}"]).backbone)


@pytest.mark.parametrize("name", PUBLISHED)
def test_presets_are_the_published_networks(name: str) -> None:
    state = preset(name).state_dict()
    found = tally(keys.backbone_names(state), state)
    assert {part: found[part] for part in PUBLISHED[name]} == PUBLISHED[name]


@pytest.mark.parametrize("name", PUBLISHED)
def test_options_read_off_shapes_are_those_of_the_preset(name: str) -> None:
    state = preset(name).state_dict()
    names = keys.backbone_names(state)
    found = keys.options_of({n: state[k] for k, n in names.items() if name == "giant" or not n.startswith("gs_head.")})
    node = compose("stylize", [f"backbone=depth_anything_{name}"]).backbone
    for option, value in found.items():
        chosen = getattr(node[option], "name", node[option])  # a choice is an enum in a typed configuration
        assert chosen == (list(value) if isinstance(value, tuple) else value), option
    assert {"dim", "depth", "heads", "alternate_from", "taps", "gaussian_channels"} <= set(found)


def fresh() -> DepthAnything:
    torch.manual_seed(3)
    return DepthAnything(**reference.TINY)


def test_the_nested_file_loads_without_its_metric_network() -> None:
    state = {f"model.da3.{name}": tensor for name, tensor in reference.tiny_weights().items()}
    state["model.da3_metric.head.projects.0.weight"] = torch.zeros(1)
    backbone = fresh()
    backbone.load_reference(state)
    own = backbone.state_dict()
    for key, name in keys.backbone_names(own).items():
        assert torch.equal(own[key].flatten(), reference.tiny_weights()[name].flatten()), name


def without_gaussians() -> dict[str, Tensor]:
    return {name: tensor for name, tensor in reference.tiny_weights().items() if not name.startswith("gs_head.")}


def test_without_a_gaussian_head_ours_stays_as_it_was() -> None:
    backbone, before = fresh(), fresh()
    assert CHECKPOINTS.parts(without_gaussians()) == {"backbone": False}
    backbone.load_reference(without_gaussians())
    for key, tensor in before.gaussian_head.state_dict().items():
        assert torch.equal(backbone.gaussian_head.state_dict()[key], tensor), key
    cls = reference.tiny_weights()["backbone.pretrained.cls_token"]
    assert torch.equal(backbone.embedder.cls_token, cls)


def test_a_stylizer_of_a_file_without_a_gaussian_head() -> None:
    own = ["backbone=depth_anything", "backbone.taps=[3,5,7,9]", "injector.hidden=8"]
    stylizer = load_reference(without_gaussians(), overrides=own)
    assert not any(tensor.is_meta for tensor in stylizer.state_dict().values())
    scene = stylizer.encode(Views(smooth_image(1, (1, 2, 3, 28, 42))))
    assert bool(stylizer.unstyled(scene).means.isfinite().all())


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (without_gaussians() | {"gs_head.projects.0.bias": torch.zeros(8)}, r"65 missing \(gs_head\."),
        ({"visual.proj": torch.zeros(1)}, r"1 keys that are not Depth Anything 3's \(visual\.proj\)"),
        ({"model.backbone.pretrained.cls_token": torch.zeros(1, 1, 4)}, "sees one view alone"),
    ],
)
def test_files_that_do_not_fit_are_named(state: dict[str, Tensor], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fresh().load_reference(state)
