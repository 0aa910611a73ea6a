"""The second stage of Stylos' training, on the least that trains."""

import pytest
import torch

from anystyle.cli.launch import launch
from anystyle.commands.train import run
from anystyle.errors import UserError
from anystyle.registry.compose import compose
from anystyle_backbones.stylos import Stylos, StylosStyle

SMALL = (
    "trainer=cpu", "trainer.max_steps=2", "workers=0", "loggers=[csv]", "renderer=cpu", "weights.backbone=null",
    "scenes=procedural", "scenes.size=28", "scenes.num_scenes=2", "scenes.samples=1", "styles=procedural",
    "styles.size=28", "styles.num_styles=2", "training.batch_size=1", "training.context_views=[2,2]",
    "training.spread=any", "training.heights=null", "training.width=null", "training.pool=2", "training.warmup=1",
    "loss.adain_voxels.network=texture", "loss.adain_voxels.layers=[relu1_1,relu2_1]",
)  # fmt: skip


def network(folder) -> list[str]:
    """A small network's options, as overrides."""
    options = {f"backbone.{name}": value for name, value in Stylos.example(folder).items()}
    options |= {f"style_encoder.{name}": value for name, value in StylosStyle.example(folder).items()}
    return [f"{name}={list(value) if isinstance(value, tuple) else value}" for name, value in options.items()]


def test_two_steps(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    launch("train", run, ["experiment=stylos", *SMALL, *network(tmp_path), "name=x"])
    assert "2 steps done; " in capsys.readouterr().out
    assert (tmp_path / "runs" / "x" / "branch.safetensors").is_file()


def test_texts_are_refused_before_a_step(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=r"reads the tokens of images, and texts have none; set training\.text_ratio=0"):
        launch("train", run, ["experiment=stylos", *SMALL, *network(tmp_path), "training.text_ratio=0.5", "name=x"])


def test_it_is_as_published_where_it_can_be():
    config = compose("train", ["experiment=stylos", "name=x", "out=x"])
    training, adain = config.training, config.loss.adain_voxels
    assert config.branch.published and config.trainer.max_steps == 30000 and config.trainer.gradient_clip_val == 1.0
    assert training.learning_rate == 2e-4 and training.aggregator_rate == 1.0 and training.weight_decay == 0.05
    assert list(training.betas) == [0.9, 0.95] and training.warmup == 1000 and training.floor == 2e-7
    assert adain.pool.name == "voxels" and adain.content_weight == 0.1 and adain.voxel_size == 0.002
    assert config.loss.diagonal_variation.weight == 10.0
