"""What is finished stays as it is, and a damaged state costs no more than the steps since the one before it."""

import hashlib

import pytest
import torch
from safetensors.torch import save_file

from anystyle.training.run import train
from tests.support.refusals import raises_line
from tests.support.training_cases import RECONSTRUCTION, configuration

pytestmark = pytest.mark.slow
WORDS = (*RECONSTRUCTION, "checkpoint.every_steps=2", "trainer.max_steps=4", "scenes.num_scenes=1")


def state(folder):
    """Every file with a hash of its content."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.md5(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture
def whole(tmp_path):
    out = tmp_path / "run"
    assert train(configuration(WORDS, out), out).finished
    return out


def test_a_finished_run_that_is_repeated_or_refused_changes_nothing(whole):
    save_file({"weight": torch.zeros(1)}, whole / "another_program.safetensors")
    before, begun = state(whole), []
    outcome = train(configuration(WORDS, whole), whole, begun.append)
    assert outcome.finished and outcome.steps == 4 and "train/loss" in outcome.metrics
    assert [path.name for path in outcome.weights] == ["backbone.safetensors"]
    with pytest.raises(ValueError, match="another configuration"):
        train(configuration((*WORDS, "seed=77"), whole), whole, begun.append)
    assert state(whole) == before and not begun
    with pytest.raises(ValueError, match="ended without best weights; resume=never"):
        train(configuration((*WORDS, "checkpoint.best=val/loss"), whole), whole)
    size = (whole / "backbone.safetensors").stat().st_size
    train(configuration((*WORDS, "export.half=false"), whole), whole)
    assert (whole / "backbone.safetensors").stat().st_size > 1.8 * size
    (whole / "metrics.json").unlink()
    assert train(configuration(WORDS, whole), whole).metrics["train/loss"] == outcome.metrics["train/loss"]
    assert (whole / "metrics.json").read_text() and set(state(whole)) >= set(before)


@pytest.mark.parametrize("damage", ["cut", "flip", "foreign", "pickle"])
def test_a_damaged_state_falls_back_to_the_one_before_and_says_so(whole, caplog, damage):
    weights, last = (whole / "backbone.safetensors").read_bytes(), whole / "last.ckpt"
    data = bytearray(last.read_bytes())
    if damage == "cut":
        data = data[: len(data) // 2]
    elif damage == "flip":
        data[len(data) // 2] ^= 255
    last.write_bytes(data)
    if damage == "foreign":
        torch.save({"a": torch.zeros(3)}, last)
    elif damage == "pickle":
        torch.save({"global_step": pytest.raises}, last)
    (whole / "metrics.json").unlink()
    outcome = train(configuration(WORDS, whole), whole)
    assert outcome.steps == 4 and (whole / "backbone.safetensors").read_bytes() == weights
    (line,) = [record.message for record in caplog.records if "resuming from previous.ckpt" in record.message]
    assert "last.ckpt" in line and "\n" not in line


def test_where_all_states_are_damaged_it_is_one_line(whole):
    for name in ("last.ckpt", "previous.ckpt"):
        (whole / name).write_bytes(b"")
    before = state(whole)
    with raises_line(ValueError, match=r"last\.ckpt .*previous\.ckpt .*resume=never"):
        train(configuration(WORDS, whole), whole)
    assert state(whole) == before
