"""A backbone in a folder outside the project, added by ANYSTYLE_PLUGINS alone."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from anystyle.commands import plugins, plugins_check
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


def test_it_is_listed(outside, capsys):
    plugins.main(["backbone"])
    shown = capsys.readouterr().out
    assert "outside" in shown
    assert "A reconstruction network of a few thousand parameters." in shown
    assert "dim: int = 24" in shown
    plugins.main(["backbone", "outside"])
    assert "backbone.patch_size: int = 8" in capsys.readouterr().out


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


def test_it_is_checked(outside, capsys):
    assert plugins_check.main(["backbone", "outside"]) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[0].startswith("backbone 'outside' (anystyle_outside:Outside, declared by ")
    assert re.fullmatch(r"\d+ promises kept, in [\d.]+ s", shown.rstrip().splitlines()[-1])


def test_the_program_finds_it_from_another_folder(outside):
    done = subprocess.run(
        [sys.executable, "-m", "anystyle", "plugins"], capture_output=True, text=True, cwd=outside.parent
    )
    assert done.returncode == 0, done.stderr
    (row,) = [line for line in done.stdout.splitlines() if line.startswith("backbone ")]
    assert "outside" in row
