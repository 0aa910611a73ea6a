"""What people give by mistake to a published network: each ends in one line, status 2, and leaves nothing."""

from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf
from PIL import Image
from safetensors.torch import save_file

from anystyle.commands import stylize
from anystyle.pipeline import encode
from anystyle.pipeline.weights import reference_config
from anystyle.registry.compose import override
from tests.support.pictures import save_photographs
from tests.support.program import failing
from tests.support.weights_cases import small_checkpoint, training_checkpoint

ENCODER = {"text_width": 64, "text_layers": 1, "image_width": 64, "image_layers": 1}


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    return save_photographs(tmp_path_factory.mktemp("photographs"), ("0.png", "1.png"), 56, 70)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory) -> Path:
    """The Head variant in miniature."""
    file = tmp_path_factory.mktemp("checkpoint") / "head.ckpt"
    torch.save(training_checkpoint("head"), file)
    return file


@pytest.fixture(scope="module")
def model(checkpoint: Path) -> list[str]:
    """The words for a model of its sizes, on the whole file."""
    sizes = OmegaConf.to_container(reference_config(small_checkpoint("head")).backbone, enum_to_str=True)
    assert isinstance(sizes, dict)
    options = [override(f"backbone.{key}", value) for key, value in sizes.items() if key != "_target_"]
    options += [override(f"style_encoder.{key}", value) for key, value in ENCODER.items()]
    return [*options, *(f"weights.{part}={checkpoint}" for part in ("backbone", "branch"))]


@pytest.fixture
def words(photographs: Path, model: list[str], tmp_path: Path) -> list[str]:
    given = [str(photographs), "--text", "dots", "--out", str(tmp_path / "out"), "model=anystyle_head"]
    return [*given, *model, "weights.style_encoder=null", "views.short_side=56"]


def refused(capsys, words: list[str], *more: str) -> str:
    """The one line that a command ends in; nothing is left behind."""
    line = failing(stylize.main, capsys, *words, *more)
    assert not Path(words[words.index("--out") + 1]).exists()
    return line


def test_files_that_are_not_the_checkpoint(words, checkpoint, tmp_path, capsys):
    save_file({"visual.proj": torch.zeros(2)}, tmp_path / "other.safetensors")
    (tmp_path / "half.ckpt").write_bytes(checkpoint.read_bytes()[:20000])
    for name, told in (
        ("other.safetensors", "not AnySplat's or AnyStyle's (visual.proj)"),
        ("half.ckpt", "is not a valid file of weights"),
    ):
        assert told in refused(capsys, words, *(f"weights.{part}={tmp_path / name}" for part in ("backbone", "branch")))


def test_a_head_checkpoint_for_a_full_model(words, capsys):
    full = ["model=anystyle_full" if word == "model=anystyle_head" else word for word in words]
    assert "trained with placement=head" in refused(capsys, full)


def test_sizes_that_are_no_multiples_where_nothing_is_resized(words, photographs, tmp_path, capsys):
    given = [*words[:-1], "views.resize=false"]
    Image.new("RGB", (70, 50)).save(tmp_path / "0.png")
    told = refused(capsys, [str(tmp_path / "0.png"), *given[1:]])
    assert "are 70x50 pixels, and sides must be multiples of 14" in told
    assert "have 2 sizes (70x50, 70x56)" in refused(capsys, [str(tmp_path / "0.png"), *given])
    assert "with views.resize=false; give one of them" in refused(capsys, [*words, "views.resize=false"])


@pytest.mark.slow
def test_more_views_than_memory_allows(words, capsys, monkeypatch):
    monkeypatch.setattr(encode, "available", lambda device: 2**20)
    assert "not even two fit: set a smaller size" in refused(capsys, words)
