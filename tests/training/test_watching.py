"""What acts on the values of validations: early stopping, and the best weights."""

import pytest
import torch
from safetensors.torch import load_file

from anystyle.errors import UserError
from anystyle.io.checkpoint import read_header
from anystyle.registry.compose import compose
from anystyle.training.run import train
from anystyle.training.stylization import StylizationTraining
from tests.support.training_cases import RECONSTRUCTION, STYLIZATION, configuration

VALIDATED = (
    "scenes@validation_scenes=procedural", "validation_scenes.size=28", "validation_scenes.num_scenes=1",
    "validation_scenes.samples=1", "validation_steps=1", "trainer.val_check_interval=2", "checkpoint.every_steps=2",
)  # fmt: skip


def test_early_stopping_ends_a_run_for_good_and_more_patience_goes_on(tmp_path, caplog):
    stopping = ("callbacks=[early_stopping]", "callbacks.early_stopping.min_delta=100")
    words = (*RECONSTRUCTION, *VALIDATED, *stopping, "callbacks.early_stopping.patience=1")
    outcome = train(configuration(words, tmp_path), tmp_path)
    assert outcome.finished and outcome.steps == 4 and outcome.weights
    assert "step 4: Monitored metric val/loss did not improve in the last 1 records" in caplog.text
    assert train(configuration(words, tmp_path), tmp_path).steps == 4
    (tmp_path / "metrics.json").unlink()  # as if the disk had been full
    assert train(configuration(words, tmp_path), tmp_path).steps == 4 and (tmp_path / "metrics.json").is_file()
    words = (*words[:-1], "callbacks.early_stopping.patience=2", "resume=changed")
    assert train(configuration(words, tmp_path), tmp_path).steps == 6


def test_the_best_weights_are_those_that_were_validated_also_after_a_sudden_end(tmp_path, monkeypatch):
    values, whole = iter([0.5, 0.3, 0.4, 0.3, 0.4]), StylizationTraining.training_step
    watched = ("checkpoint.best=val/loss", "+callbacks.early_stopping.monitor=val/loss")
    words = (*STYLIZATION, *VALIDATED, "average=0.9", *watched)
    seen = {}

    def validation_step(self, batch, step):
        name = next(iter(self.stylizer.branch.state_dict()))
        seen[self.global_step] = self.stylizer.branch.state_dict()[name].clone()
        self.log("val/loss", torch.tensor(next(values)))

    def training_step(self, batch, step):
        if step == 4 and len(seen) == 2:
            raise RuntimeError("power failure")
        return whole(self, batch, step)

    monkeypatch.setattr(StylizationTraining, "validation_step", validation_step)
    monkeypatch.setattr(StylizationTraining, "training_step", training_step)
    with pytest.raises(RuntimeError, match="power failure"):
        train(configuration(words, tmp_path), tmp_path)
    seen[0] = torch.zeros(())
    assert train(configuration(words, tmp_path), tmp_path).steps == 6 and set(seen) == {0, 2, 4, 6}
    made = read_header(tmp_path / "best" / "branch.safetensors").provenance
    assert made["steps"] == 4 and made["val/loss"] == pytest.approx(0.3)
    kept = load_file(tmp_path / "best" / "branch.safetensors")
    assert any(torch.equal(value.float(), seen[4].half().float()) for value in kept.values())
    state = torch.load(tmp_path / "last.ckpt", weights_only=True)["callbacks"]
    waited = [each["wait_count"] for each in state.values() if "wait_count" in each]
    assert waited == [1, 1], "as without the sudden end"


def test_a_branch_is_validated_on_scenes_of_its_own_by_the_same_draws(tmp_path):
    words = (*STYLIZATION, *VALIDATED, "validation_scenes.split=heldout", "trainer.val_check_interval=1")
    outcomes = [
        train(configuration((*words, f"trainer.max_steps={steps}", "training.learning_rate=1e-30"), out), out)
        for steps in (1, 2)
        for out in [tmp_path / str(steps)]
    ]
    (first, later) = (outcome.metrics for outcome in outcomes)
    assert {"val/loss", "val/clip_directional"} <= set(first) and first["val/loss"] != first["train/loss"]
    assert later["val/loss"] == pytest.approx(first["val/loss"], rel=1e-6)


@pytest.mark.parametrize(
    ("word", "answer"),
    [
        ("checkpoint.best=val/lsos", "no logged value is named 'val/lsos'. Did you mean 'val/loss'?"),
        ("validation_steps=0", "val/loss: no validation is within .* add scenes@validation_scenes=NAME"),
        ("trainer.val_check_interval=7", "no validation is within the run's 6 batches; .*val_check_interval=N"),
        ("+callbacks.early_stopping.patiance=2", "EarlyStopping.*'patiance'; the options are those of"),
        ("+callbacks.early_stoping.patience=2", "no callback is named 'early_stoping'. Did you mean 'early_stopping'?"),
    ],
)
def test_a_value_that_nothing_would_log_is_refused(tmp_path, caplog, word, answer):
    with pytest.raises(UserError, match=answer.replace("?", r"\?")):
        train(configuration((*RECONSTRUCTION, *VALIDATED, "checkpoint.best=val/loss", word), tmp_path), tmp_path)
    assert ("the run has 6 batches and is never validated" in caplog.text) == ("interval=7" in word)


@pytest.mark.parametrize(
    ("word", "answer"),
    [
        ("trainer.callbacks=[early_stopping]", r"callbacks=\[early_stopping\]"),
        ("callbacks=[model_checkpoint]", "checkpoint.best=val/loss"),
        ("+ckpt_path=last.ckpt", "the same command resumes"),
        ("trainer.resume_from_checkpoint=last.ckpt", "the same command resumes"),
        ("logger=wandb", r"loggers=\[wandb\]"),
        ("trainer.max_epochs=3", "trainer.max_steps=N"),
        ("trainer.limit_train_batches=3", "trainer.max_steps=N, or training.pool=N"),
        ("+compile=true", "not compiled"),
        ("+lr=1e-4", "training.learning_rate=RATE"),
        ("max_steps=3", r"write trainer\.max_steps=N"),
        ("batch_size=3", r"write training\.batch_size=N"),
    ],
)
def test_a_word_of_lightnings_is_answered_by_the_one_to_write(word, answer):
    with pytest.raises(UserError, match=answer):
        compose("train", [*STYLIZATION, "out=x", word])
    config = compose("train", [*STYLIZATION, "out=x", "+lr=1e-4", "training.learning_rate=${lr}"])
    assert config.training.learning_rate == 1e-4
