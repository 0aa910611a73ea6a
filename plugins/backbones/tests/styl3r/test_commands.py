"""From the command line: photographs to a scene, and the experiment's two steps."""

import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData

from anystyle.cli.launch import launch
from anystyle.commands import stylize
from anystyle.commands.train import run
from anystyle.registry.compose import compose

TRUNK = ("dim=32", "depth=2", "heads=2")
SMALL = (
    *(f"backbone.{word}" for word in (*TRUNK, "decoder_dim=24", "decoder_depth=4", "decoder_heads=2", "resolution=32")),
    "backbone.features=16", "backbone.channels=[8,8,8,8]", "backbone.hidden=8",
    *(f"style_encoder.{word}" for word in (*TRUNK, "resolution=32")),
    "weights.backbone=null",
)  # fmt: skip


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    folder = tmp_path / "photographs"
    folder.mkdir()
    pixels = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    for number in range(3):
        Image.fromarray(np.roll(pixels, 3 * number, 1)).save(folder / f"{number}.png")
    return folder


def test_photographs_in_the_style_of_a_picture(
    photographs: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    words = [photographs, "--image", photographs / "0.png", "--out", tmp_path / "out", "model=styl3r", *SMALL]
    with caplog.at_level(logging.INFO):
        stylize.main([*map(str, words), "poses=predicted", "video.frames=2"])
    for scene in (scenes := list((tmp_path / "out").rglob("*.ply"))):
        assert len(PlyData.read(scene)["vertex"]) == 3 * 32 * 48
    assert scenes
    told = [record.message for record in caplog.records]
    assert any("the backbone is untrained" in line for line in told)
    assert any("a field of view of 60 degrees" in line for line in told)


def test_a_text_is_refused_in_one_line(photographs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [photographs, "--text", "red", "--out", tmp_path / "out", "model=styl3r", *SMALL, "poses=predicted"]
    with pytest.raises(SystemExit) as caught:
        stylize.main([str(word) for word in words])
    assert caught.value.code == 2
    assert "Styl3R reads style images, no texts" in capsys.readouterr().err.splitlines()[-1]


def test_the_experiment_is_the_published_second_stage() -> None:
    config = compose("train", ["experiment=styl3r", "name=x", "out=x"])
    assert (config.loss.content.weight, config.loss.style.weight, config.loss.identity.weight) == (1, 10, 1)
    assert config.loss.identity.pixels == 70 and config.loss.content.layers == ["relu3_1", "relu4_1"]
    assert config.style_encoder.style_range.name == "symmetric" and config.styles.text_only == 0
    assert config.training.learning_rate == 2e-4 and config.training.aggregator_rate == 1
    assert config.trainer.max_steps == 35001 and config.trainer.gradient_clip_val == 0.5 and config.branch.published


def test_the_experiment_takes_two_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    losses = [f"loss.{name}.network=texture" for name in ("content", "style", "identity")]
    data = ["scenes=procedural", "scenes.num_scenes=2", "scenes.samples=1", "styles=procedural", "styles.num_styles=2"]
    steps = ["trainer=cpu", "trainer.max_steps=2", "training.warmup=1", "workers=0", "loggers=[csv]", "name=x"]
    size = ["training.batch_size=1", "training.context_views=[2,2]", "training.spread=any", "training.heights=[32,32]"]
    size += ["training.width=32", "training.preview_every=1"]
    launch("train", run, ["experiment=styl3r", *SMALL, *losses, *data, *size, *steps])
    assert "2 steps done; " in capsys.readouterr().out
    assert len(list((tmp_path / "runs" / "x" / "previews").iterdir())) == 2
