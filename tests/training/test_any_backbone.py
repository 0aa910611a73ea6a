"""Every recipe that comes along trains a backbone, or on one, that `anystyle plugins new` has just written."""

import sys

import pytest

from anystyle.cli.launch import launch
from anystyle.commands import plugins_new
from anystyle.commands.train import run
from anystyle.io.documents import read_yaml
from anystyle.registry.packages import presets

SMALL = ("training.warmup=1", "trainer.max_steps=2", "trainer=cpu", "workers=0", "loggers=[csv]")
SCENES = ("scenes=procedural", "scenes.num_scenes=2", "scenes.samples=1")
ONE_SCENE = ("training.batch_size=1", "training.context_views=[2,2]")
STYLE = (*SCENES, *ONE_SCENE, "training.pool=2", "training.cache_scenes=2", "training.preview_every=0")
PAPER = (*STYLE, "styles.num_styles=2", "loss.content.network=texture", "loss.style.network=texture",
         "loss.content.layers=[relu3_1]", "loss.style.layers=[relu1_1]", "loss.clip_patch.crops=1")  # fmt: skip
VALIDATED = ("validation_scenes.num_scenes=2", "validation_scenes.samples=1", "validation_steps=1")
RECIPES = {
    "tiny_style": PAPER,
    "tiny_reconstruction": (*SCENES, *ONE_SCENE, *VALIDATED),
    "tiny_ablation": (*PAPER, "cache=null"),
    "tiny_mechanisms": PAPER,
    "paper_head": (
        *PAPER, "renderer=cpu", "styles=procedural", "style_encoder=tiny", "weights.style_encoder=tiny_style_encoder",
        "training.spread=any", "training.heights=[32,32]", "training.width=32", "training.preview_texts=[a]",
    ),
    "styl3r": (
        *STYLE, "branch.published=false", "renderer=cpu", "styles=procedural", "styles.num_styles=2",
        "style_encoder=tiny", *(f"weights.{part}=null" for part in ("backbone", "branch")),
        "weights.style_encoder=tiny_style_encoder", "training.spread=any", "training.heights=[32,32]",
        "training.width=32", *(f"loss.{name}.network=texture" for name in ("content", "style", "identity")),
    ),
}  # fmt: skip
SLOW = ("tiny_ablation", "tiny_mechanisms")
"""Of equal parts with quicker ones."""


def test_every_recipe_is_here():
    recipes = {name: read_yaml(path, dict, what="experiment") for name, path in presets("experiment").items()}
    others = {name for name, recipe in recipes.items() if "backbone" in recipe}
    assert others == {"paper_full", "stylos"}
    assert RECIPES.keys() == recipes.keys() - others


@pytest.fixture(scope="module")
def plugins(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugins")
    plugins_new.main(["backbone", "fresh", "--into", str(folder)])
    return folder


@pytest.mark.parametrize(
    "experiment", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in RECIPES]
)
def test_a_recipe_trains_with_a_backbone_that_is_new(experiment, plugins, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(plugins))
    monkeypatch.setattr("sys.path", list(sys.path))
    launch("train", run, [f"experiment={experiment}", "backbone=fresh", *SMALL, *RECIPES[experiment], "name=x"])
    assert "2 steps done; " in capsys.readouterr().out
