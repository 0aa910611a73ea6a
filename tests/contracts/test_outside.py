"""A backbone in a folder outside the project, added by ANYSTYLE_PLUGINS alone."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from anystyle.commands.plugins_new import write
from anystyle.contracts import Backbone
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle.registry.compose import compose


@pytest.fixture
def outside(tmp_path: Path, monkeypatch) -> Iterator[Path]:
    folder = write("backbone", "outside", tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(folder))
    monkeypatch.setattr("sys.path", list(sys.path))
    yield folder
    # Python imports a module once a process, and the next test writes another of this name.
    sys.modules.pop("anystyle_outside", None)


def test_it_is_composed_with_typed_options_and_built(outside):
    config = compose("stylize", ["backbone=outside", "backbone.dim=16"])
    assert OmegaConf.to_container(config.backbone) == {
        "_target_": "anystyle_outside.Outside",
        "dim": 16,
        "depth": 3,
        "patch_size": 8,
    }
    backbone = build(Backbone, config.backbone)
    assert type(backbone).__name__ == "Outside"
    assert backbone.sites[0].dim == 16
    with pytest.raises(UserError, match="could not be converted to Integer"):
        compose("stylize", ["backbone=outside", "backbone.depth=deep"])
    with pytest.raises(UserError, match="Did you mean 'depth'"):
        compose("stylize", ["backbone=outside", "backbone.dpeth=3"])
