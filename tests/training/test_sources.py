"""Every recipe takes one's own scenes and styles, of whatever source."""

from itertools import zip_longest
from pathlib import Path

import pytest
from PIL import Image

import anystyle
from anystyle.cli.launch import launch
from anystyle.commands.train import run
from anystyle.contracts import SceneSource, StyleSource
from anystyle.registry.compose import choices, compose
from tests.support.training_cases import BACKBONE

SMALL = (
    *BACKBONE, "trainer.max_steps=2", "training.warmup=1", "training.batch_size=1", "training.pool=2",
    "training.cache_scenes=2", "training.preview_every=0", "scenes=folder", "scenes.root=captures", "styles=folder",
    "styles.root=paintings", "scenes.short_side=28", "styles.size=28", "styles.crop=random",
)  # fmt: skip


@pytest.mark.parametrize("experiment", choices("experiment"))
def test_a_recipe_composes_with_every_source(experiment, monkeypatch):
    monkeypatch.setattr("anystyle.registry.catalog._OWN", {})

    @anystyle.plugin("scenes", "mine")
    class Captures(SceneSource):
        """Of a stranger, without an option."""

    @anystyle.plugin("styles", "mine")
    class Paintings(StyleSource):
        """Of a stranger, without an option."""

    scenes, styles = choices("scenes"), choices("styles")
    assert len(scenes) > len(styles) and "mine" in scenes and "mine" in styles
    for chosen, painted in zip_longest(scenes, styles, fillvalue="mine"):
        words = [f"scenes={chosen}", f"scenes@validation_scenes={chosen}", f"styles={painted}"]
        compose("train", [f"experiment={experiment}", *words, f"styles@validation_styles={painted}", "name=x", "out=x"])


@pytest.mark.parametrize("experiment", ["tiny_style", "tiny_mechanisms"])
def test_a_recipe_learns_from_folders_of_ones_own(experiment, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for file in ("captures/one/0.png", "captures/one/1.png", "paintings/a.png"):
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Image.linear_gradient("L").resize((56, 42)).save(file)
    losses = ["without=[clip_patch]"] if experiment == "tiny_style" else []
    launch("train", run, [f"experiment={experiment}", *SMALL, *losses, "name=x"])
    assert "2 steps done; branch.safetensors in" in capsys.readouterr().out
    assert not Path("x/scenes").exists()  # photographs are files already: no cache is made of them
