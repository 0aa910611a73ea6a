"""Whole runs, a second each: they learn, they continue bit for bit, and they stop when they should."""

import json
import shutil
import signal

import pytest
import torch
from safetensors.torch import load_file

import anystyle
from anystyle.contracts import Backbone
from anystyle.io.checkpoint import load_part, read_header
from anystyle.registry.build import build
from anystyle.training import run as module
from anystyle.training.run import train
from anystyle_tiny.training.reconstruction import ReconstructionTraining
from tests.support.training_cases import RECONSTRUCTION, configuration
from tests.training.test_watching import VALIDATED


def stop_at(monkeypatch, step: int, how: str) -> None:
    """Let the training meet its end at a step: a signal, or a sudden error as if the power failed."""
    whole = ReconstructionTraining.training_step

    def training_step(self, batch, index):
        if index == step:
            if how == "signal":
                signal.raise_signal(signal.SIGTERM)
            else:
                raise RuntimeError("power failure")
        return whole(self, batch, index)

    monkeypatch.setattr(ReconstructionTraining, "training_step", training_step)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """A run and its folder; the checkout moves on after the run began."""
    out, where, whole = tmp_path_factory.mktemp("whole"), ["begun"], ReconstructionTraining.training_step

    def training_step(self, batch, index):
        where[0] = "moved on"
        return whole(self, batch, index)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "commit", lambda: where[0])
        patch.setattr(ReconstructionTraining, "training_step", training_step)
        state = torch.random.get_rng_state()
        outcome = anystyle.train(RECONSTRUCTION, out)
        assert torch.equal(torch.random.get_rng_state(), state)  # the caller's random numbers go on
        return out, outcome


def test_a_run_leaves_weights_that_say_how_they_were_made(uninterrupted):
    out, outcome = uninterrupted
    assert outcome.finished and outcome.steps == 6
    header = read_header(out / "backbone.safetensors")
    made = {name: header.provenance[name] for name in ("steps", "seed", "commit")}
    assert header.part == "backbone" and made == {"steps": 6, "seed": 0, "commit": "begun"}
    load_part(out / "backbone.safetensors", build(Backbone, header.config["backbone"]), "backbone")
    assert json.loads((out / "metrics.json").read_text())["train/loss"] == pytest.approx(outcome.metrics["train/loss"])


def test_a_run_leaves_torch_as_it_was(tmp_path):
    before = torch.are_deterministic_algorithms_enabled()
    try:
        for enabled in (False, True):
            torch.use_deterministic_algorithms(enabled)
            anystyle.train([*RECONSTRUCTION, "fast_dev_run=true"], tmp_path)
            assert torch.are_deterministic_algorithms_enabled() == enabled
    finally:
        torch.use_deterministic_algorithms(before)


@pytest.mark.parametrize(("how", "step"), [("signal", 3), pytest.param("failure", 5, marks=pytest.mark.slow)])
def test_a_run_that_was_stopped_ends_with_the_same_weights(uninterrupted, tmp_path, monkeypatch, how, step):
    whole, _ = uninterrupted
    overrides = (*RECONSTRUCTION, "checkpoint.every_steps=2")
    with monkeypatch.context() as patch:
        stop_at(patch, step, how)
        if how == "signal":
            outcome = train(configuration(overrides, tmp_path), tmp_path)
            assert not outcome.finished and outcome.steps == step + 1
        else:
            with pytest.raises(RuntimeError, match="power failure"):
                train(configuration(overrides, tmp_path), tmp_path)
    assert not (tmp_path / "backbone.safetensors").exists()
    assert train(configuration(overrides, tmp_path), tmp_path).finished
    first, second = (load_file(out / "backbone.safetensors") for out in (whole, tmp_path))
    assert all(torch.equal(first[key], second[key]) for key in first)


def test_a_run_of_another_configuration_is_not_continued(uninterrupted):
    out, _ = uninterrupted
    with pytest.raises(ValueError, match=r"training.learning_rate 0.001 -> 0.5\).*resume=changed"):
        train(configuration((*RECONSTRUCTION, "training.learning_rate=0.5"), out), out)
    # What does not change the result may change.
    assert train(configuration((*RECONSTRUCTION, "checkpoint.every_steps=1"), out), out).finished


def test_a_checkpoint_of_nobody_knows_what_is_not_continued(uninterrupted, tmp_path):
    shutil.copy(uninterrupted[0] / "last.ckpt", tmp_path / "last.ckpt")
    with pytest.raises(ValueError, match=r"no bound.json with its configuration; pass resume=changed"):
        train(configuration(RECONSTRUCTION, tmp_path), tmp_path)
    assert train(configuration((*RECONSTRUCTION, "resume=changed"), tmp_path), tmp_path).finished


def test_two_runs_do_not_share_a_folder(tmp_path):
    with module.exclusive(tmp_path):
        with pytest.raises(ValueError, match=r"another run is at work in .*; wait for its end"):
            train(configuration(RECONSTRUCTION, tmp_path), tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == [".lock"]
    with module.exclusive(tmp_path):
        pass


@pytest.mark.parametrize("more", [(), (*VALIDATED, "trainer.val_check_interval=1")])
def test_a_run_that_diverges_before_its_loss_is_known_stops_and_keeps_the_batch(tmp_path, more):
    """Cameras of scenes are aligned by a singular value decomposition, which takes no NaN; so do validations."""
    large = ("training.learning_rate=1e10", "training.warmup=0", *more)
    with pytest.raises(ValueError, match=r"at step 1 what \S+ computes is not finite; the batch is in .* Lower"):
        train(configuration((*RECONSTRUCTION, *large), tmp_path), tmp_path)
    assert torch.load(tmp_path / "refused_batch.pt", weights_only=False)["step"] == 1


def test_a_loss_that_is_no_number_stops_the_run_and_keeps_the_batch(tmp_path, monkeypatch):
    monkeypatch.setattr(
        ReconstructionTraining, "total", lambda self, losses: torch.stack(list(losses.values())).sum() * float("nan")
    )
    with pytest.raises(ValueError, match="at step 0 the loss is nan; the batch is in"):
        train(configuration(RECONSTRUCTION, tmp_path), tmp_path)
    kept = torch.load(tmp_path / "refused_batch.pt", weights_only=False)
    assert kept["step"] == 0 and kept["batch"].views.images.shape[0] == 2
    assert not (tmp_path / "last.ckpt").exists()
