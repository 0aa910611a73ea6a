"""Published checkpoints: names, and strict loading."""

import re
from pathlib import Path

import pytest
import torch
from torch import Tensor

from anystyle.branch import StyleBranch
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.placements import Full, Head
from anystyle.types import Site
from anystyle_backbones.anysplat import AnySplat, keys

# Numbers of keys and parameters of the published modules; the embedder's unused mask token is the only key we lack.
PUBLISHED = {
    "aggregator": (1210, 909_112_320),
    "camera_head": (69, 216_174_610),
    "depth_head": (62, 32_654_562),
    "gaussian_param_head": (64, 32_794_964),
}
CHECKPOINTS = keys.AnySplatCheckpoints()
MASK = {"aggregator": (1, 1024)}


def published_injector(site: Site) -> ZeroConv:
    return ZeroConv(dim=site.dim, style_dim=512, hidden=256 if site.name == "head/direct" else 1024)


@pytest.fixture(scope="module")
def full_size() -> AnySplat:
    with torch.device("meta"):
        return AnySplat()


def tally(names: dict[str, str], state: dict[str, Tensor]) -> dict[str, tuple[int, int]]:
    parts: dict[str, tuple[int, int]] = {}
    for key, name in names.items():
        part = name.partition(".")[0]
        count, size = parts.get(part, (0, 0))
        parts[part] = (count + 1, size + state[key].numel())
    return parts


def test_the_defaults_are_the_published_network(full_size: AnySplat) -> None:
    state = full_size.state_dict()
    parts = tally(keys.backbone_names(state), state)
    for part, (count, size) in MASK.items():
        parts[part] = (parts[part][0] + count, parts[part][1] + size)
    assert parts == PUBLISHED
    assert sum(count for count, _ in parts.values()) == 1405
    assert sum(size for _, size in parts.values()) == 1_190_736_456


@pytest.mark.parametrize(
    ("placement", "expected"),
    [
        (Head(), {"gaussian_param_head_style": (94, 60_259_156)}),
        (Full(), {"gaussian_param_head_style": (94, 60_259_156), "aggregator_injection": (894, 617_851_904)}),
    ],
    ids=["head", "full"],
)
def test_a_branch_is_the_published_one(full_size: AnySplat, placement: Head | Full, expected: dict[str, tuple]) -> None:
    with torch.device("meta"):
        branch = StyleBranch(full_size, sites=placement.select(full_size.sites), make_injector=published_injector)
    state = branch.state_dict()
    assert tally(keys.branch_names(state), state) == expected


@pytest.fixture(scope="module")
def small() -> AnySplat:
    return AnySplat(**AnySplat.example(Path()))


def as_published(module: torch.nn.Module, names: dict[str, str], prefix: str = "encoder.") -> dict[str, Tensor]:
    """A module's state under published names, 1x1 convolutions as such."""
    state = {}
    for key, name in names.items():
        tensor = module.state_dict()[key].clone()
        linear_here = re.search(r"projects\.\d\.weight|zero_proj\.weight", name)
        state[prefix + name] = tensor[:, :, None, None] if linear_here else tensor
    return state


def checkpoint(backbone: AnySplat, prefix: str = "encoder.") -> dict[str, Tensor]:
    state = as_published(backbone, keys.backbone_names(backbone.state_dict()), prefix)
    return state | {f"{prefix}aggregator.patch_embed.mask_token": torch.zeros(1, 32)}


def small_branch(backbone: AnySplat, placement: Head | Full) -> StyleBranch:
    return StyleBranch(
        backbone,
        sites=placement.select(backbone.sites),
        make_injector=lambda site: ZeroConv(dim=site.dim, style_dim=12, hidden=8),
    )


def randomised(module: torch.nn.Module, seed: int) -> torch.nn.Module:
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.copy_(torch.randn(parameter.shape, generator=generator))
    return module


@pytest.mark.parametrize("prefix", ["encoder.", "model.encoder.", ""])
def test_weights_survive_the_way_there_and_back(small: AnySplat, prefix: str) -> None:
    other = AnySplat(**AnySplat.example(Path()))
    randomised(other, 1)
    small.load_reference(checkpoint(other, prefix))
    for key, tensor in other.state_dict().items():
        assert torch.equal(small.state_dict()[key], tensor), key


@pytest.mark.parametrize("placement", [Head(), Full()], ids=["head", "full"])
def test_a_style_checkpoint_holds_backbone_branch_and_text_adapter(small: AnySplat, placement: Head | Full) -> None:
    source = randomised(small_branch(small, placement), 2)
    adapter = {f"model.encoder.text_adapter.mlp.{place}.weight": torch.full((2, 2), place) for place in (0, 2)}
    state = checkpoint(small, "model.encoder.") | adapter
    state |= as_published(source, keys.branch_names(source.state_dict()), "model.encoder.")
    assert CHECKPOINTS.config(state)["placement"] == ("full" if isinstance(placement, Full) else "head")
    assert CHECKPOINTS.config(state)["style_encoder.text_adapter"] is True
    assert CHECKPOINTS.parts(state) == {"backbone": True, "branch": True, "style_encoder": False}
    branch = small_branch(small, placement)
    CHECKPOINTS.load("branch", branch, state)
    for key, tensor in source.state_dict().items():
        assert torch.equal(branch.state_dict()[key], tensor), key
    small.load_reference(state)


def test_the_head_checkpoint_does_not_load_into_a_full_branch_nor_the_other_way(small: AnySplat) -> None:
    head, full = (small_branch(small, placement) for placement in (Head(), Full()))
    of_head, of_full = (as_published(branch, keys.branch_names(branch.state_dict())) for branch in (head, full))
    with pytest.raises(ValueError, match=r"style branch: \d+ missing \(aggregator_injection"):
        CHECKPOINTS.load("branch", full, of_head)
    with pytest.raises(ValueError, match=r"style branch: \d+ unexpected \(aggregator_injection"):
        CHECKPOINTS.load("branch", head, of_full)


def test_up_to_five_differences_of_a_kind_are_named(small: AnySplat) -> None:
    state = checkpoint(small)
    for key in [key for key in state if ".frame_blocks.0." in key]:
        del state[key]
    state["encoder.camera_head.extra.weight"] = torch.zeros(1)
    state["encoder.camera_head.embed_pose.weight"] = torch.zeros(3, 9)
    before = {key: tensor.clone() for key, tensor in small.state_dict().items()}
    with pytest.raises(ValueError) as caught:
        small.load_reference(state)
    message = str(caught.value)
    assert "18 missing (" in message and message.count("frame_blocks.0.") == 5 and "…" in message
    assert "1 unexpected (camera_head.extra.weight)" in message
    assert "1 misshapen (camera_head.embed_pose.weight is [3, 9], not [64, 9])" in message
    assert "\n" not in message
    assert all(torch.equal(before[key], tensor) for key, tensor in small.state_dict().items())
