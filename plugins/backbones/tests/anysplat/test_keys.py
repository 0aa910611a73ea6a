"""Published checkpoints: their sizes, their style branches, and what VGGT and AnyStyle leave out or add."""

import pytest
import torch

from anystyle.branch import StyleBranch
from anystyle_backbones.anysplat import AnySplat, keys
from tests.support.anysplat_reference import published_injector
from tests.support.backbone_cases import network, tally
from tests.support.weights_cases import PLACEMENTS, small_checkpoint

# Numbers of keys and parameters of the published modules; the embedder's unused mask token is the only key we lack.
PUBLISHED = {
    "aggregator": (1210, 909_112_320),
    "camera_head": (69, 216_174_610),
    "depth_head": (62, 32_654_562),
    "gaussian_param_head": (64, 32_794_964),
}
STYLED = {
    "head": {"gaussian_param_head_style": (94, 60_259_156)},
    "full": {"gaussian_param_head_style": (94, 60_259_156), "aggregator_injection": (894, 617_851_904)},
}
CHECKPOINTS = keys.AnySplatCheckpoints()


def branch_on(backbone: AnySplat, placement: str) -> StyleBranch:
    sites = PLACEMENTS[placement].select(backbone.sites)
    return StyleBranch(backbone, sites=sites, make_injector=published_injector)


@pytest.fixture(scope="module")
def full_size() -> AnySplat:
    with torch.device("meta"):
        return AnySplat()


def test_the_defaults_are_the_published_network(full_size: AnySplat) -> None:
    state = full_size.state_dict() | {"mask": torch.empty(1, 1024, device="meta")}
    assert tally(keys.backbone_names(full_size.state_dict()) | {"mask": keys.UNUSED[0]}, state) == PUBLISHED


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_branch_is_the_published_one(full_size: AnySplat, placement: str) -> None:
    with torch.device("meta"):
        state = branch_on(full_size, placement).state_dict()
    assert tally(keys.branch_names(state), state) == STYLED[placement]


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_style_checkpoint_holds_backbone_branch_and_text_adapter(placement: str) -> None:
    state = small_checkpoint(placement, "model.encoder.")
    config = CHECKPOINTS.config(state)
    assert config["placement"] == placement and config["style_encoder.text_adapter"] is True
    assert CHECKPOINTS.parts(state) == {"backbone": True, "branch": True, "style_encoder": False}
    backbone = network("anysplat")
    branch = branch_on(backbone, placement)
    backbone.load_reference(state)
    CHECKPOINTS.load("branch", branch, state)
    for module, names in ((backbone, keys.backbone_names), (branch, keys.branch_names)):
        for key, name in names(module.state_dict()).items():
            loaded, expected = module.state_dict()[key], state[f"model.encoder.{name}"]
            assert torch.equal(loaded, expected.view_as(loaded)), name


def test_the_head_checkpoint_does_not_load_into_a_full_branch_nor_the_other_way() -> None:
    head, full = (branch_on(network("anysplat"), placement) for placement in ("head", "full"))
    with pytest.raises(ValueError, match=r"style branch: \d+ missing \(aggregator_injection.*placement=head"):
        CHECKPOINTS.load("branch", full, small_checkpoint("head"))
    with pytest.raises(ValueError, match=r"style branch: \d+ unexpected \(aggregator_injection.*placement=full"):
        CHECKPOINTS.load("branch", head, small_checkpoint("full"))


def test_up_to_five_differences_of_a_kind_are_named() -> None:
    state = {key: value for key, value in small_checkpoint(None).items() if ".frame_blocks.0." not in key}
    state |= {"camera_head.extra.weight": torch.zeros(1), "camera_head.embed_pose.weight": torch.zeros(3, 9)}
    with pytest.raises(ValueError) as caught:
        network("anysplat").load_reference(state)
    message = str(caught.value)
    assert "18 missing (" in message and message.count("frame_blocks.0.") == 5 and "…" in message
    assert "1 unexpected (camera_head.extra.weight)" in message
    assert "1 misshapen (camera_head.embed_pose.weight is [3, 9], not [64, 9])" in message
