"""The library's front door."""

import pytest
import torch

import anystyle
from anystyle.contracts import Placement
from anystyle.registry.catalog import PluginError
from anystyle.types import Views

UNTRAINED = ["weights.backbone=null", "weights.style_encoder=null", "weights.branch=null"]


def test_load_is_ready_for_use():
    stylizer = anystyle.load("tiny", UNTRAINED)
    assert isinstance(stylizer, anystyle.Stylizer)
    assert not any(module.training for module in stylizer.modules())
    assert not any(parameter.requires_grad for parameter in stylizer.parameters())
    side = stylizer.backbone.patch_size * 4
    images = torch.rand(1, 2, 3, side, side, generator=torch.Generator().manual_seed(0))
    gaussians = stylizer.restyle(stylizer.encode(Views(images)), stylizer.embed(text="blue ink"))
    assert gaussians.means.shape[-1] == 3 and torch.isfinite(gaussians.means).all()


def test_load_takes_overrides():
    assert anystyle.load("tiny", [*UNTRAINED, "branch.styled=[color]"]).branch.styled == ("color",)


def test_load_says_what_is_wrong():
    with pytest.raises(ValueError, match=r"Could not find 'model/tyny'\. Did you mean 'tiny'\?"):
        anystyle.load("tyny")
    with pytest.raises(ValueError, match="Could not override 'sed': Key 'sed' is unknown"):
        anystyle.load("tiny", ["sed=1"])


def test_build_takes_a_name():
    assert type(anystyle.build(Placement, "head")) is anystyle.catalog().find("placement", "head").load()
    with pytest.raises(PluginError, match=r"no placement is named 'haed'\. Did you mean 'head'\?"):
        anystyle.build(Placement, "haed")
