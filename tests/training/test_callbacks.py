"""Seeds, averages and guards, against closed forms."""

import os
import signal
import time
import warnings
from datetime import timedelta
from unittest.mock import Mock

import lightning.pytorch as pl
import numpy as np
import pytest
import torch
from torch import nn

from anystyle.training.callbacks import STOPS, MovingAverage, RunCheckpoint, StepSeed, StepTimer, requeue
from anystyle.training.optim import learning_rate, scheduled, trainable
from anystyle.training.safeguards import SkipOutliers
from anystyle_tiny.training.decay import decayed_groups


class Module(pl.LightningModule):
    """One weight and a bias."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(1, 1))
        self.bias = nn.Parameter(torch.zeros(1), requires_grad=False)


def at(step: int = 0, rank: int = 0, accumulated: int = 1) -> pl.Trainer:
    """The little of a trainer that callbacks look at."""
    trainer = Mock(spec=pl.Trainer)
    trainer.global_step, trainer.global_rank, trainer.accumulate_grad_batches = step, rank, accumulated
    return trainer


def saving(step: int = 0) -> tuple[pl.Trainer, list[int]]:
    """A trainer that writes empty checkpoints, and the steps at which it did."""
    trainer, steps = at(step), []
    trainer.callback_metrics = {}
    trainer.strategy.reduce_boolean_decision.side_effect = lambda decision, all: decision
    trainer.save_checkpoint.side_effect = lambda path: steps.append(trainer.global_step) or path.write_bytes(b"")
    return trainer, steps


def draw(seed: int, step: int, rank: int = 0) -> float:
    StepSeed(seed).on_train_batch_start(at(rank=rank), Module(), None, step)
    return torch.rand(()).item()


def test_a_steps_randomness_depends_on_seed_and_step_alone():
    assert draw(1, 2, 3) == draw(1, 2, 0)
    assert len({draw(seed, step) for seed in range(8) for step in range(8)}) == 64
    # Neighbouring words give unrelated numbers.
    series = np.array([draw(0, step) for step in range(400)])
    assert abs(np.corrcoef(series[:-1], series[1:])[0, 1]) < 0.15
    assert abs(series.mean() - 0.5) < 0.05


@pytest.mark.parametrize("batches", [1, 4])
def test_the_average_is_the_one_of_its_definition(batches):
    module = Module()
    average, expected, decay = MovingAverage(0.9), None, 0.9
    for step, value in enumerate([1.0, 3.0, -2.0, 5.0], start=1):
        for batch in range(batches):
            is_last = batch == batches - 1
            module.weight.data.fill_(value if is_last else 100.0)
            trainer = at(step if is_last else step - 1, accumulated=batches)
            average.on_train_batch_end(trainer, module, None, None, batches * (step - 1) + batch)
        share = min(decay, (1 + step) / (10 + step))
        expected = value if expected is None else share * expected + (1 - share) * value
    assert average.weights["weight"].item() == pytest.approx(expected)
    average.swap(module)
    assert module.weight.item() == pytest.approx(expected)
    average.swap(module)
    assert module.weight.item() == 5.0
    again = MovingAverage(0.9)
    again.load_state_dict(average.state_dict())
    assert torch.equal(again.weights["weight"], average.weights["weight"])


@pytest.mark.parametrize("name", [each.name for each in STOPS if each != signal.SIGINT])
def test_a_checkpoint_is_written_between_steps_and_once_a_step(tmp_path, name, monkeypatch):
    monkeypatch.delenv("SLURM_JOB_ID", raising=False)
    keeper, (trainer, steps) = RunCheckpoint(tmp_path / "last.ckpt", every_steps=2), saving()
    keeper.on_train_start(trainer, Module())
    # Two batches a step, whose gradients are accumulated.
    for batch, step in enumerate([0, 1, 1, 2, 2, 3]):
        trainer.global_step = step
        if batch == 4:
            os.kill(os.getpid(), signal.Signals[name])
        keeper.on_train_batch_end(trainer, Module(), None, None, batch)
    keeper.on_train_end(trainer, Module())
    assert steps == [2, 3] and keeper.stopped_by == name


@pytest.mark.parametrize(
    ("job", "asked"),
    [
        ({"SLURM_JOB_ID": "77"}, "requeue 77"),
        ({"SLURM_JOB_ID": "78", "SLURM_ARRAY_JOB_ID": "77", "SLURM_ARRAY_TASK_ID": "3"}, "requeue 77_3"),
    ],
)
def test_a_job_of_slurm_is_requeued(tmp_path, monkeypatch, job, asked):
    program = tmp_path / "scontrol"
    program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/asked\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    for name, value in job.items():
        monkeypatch.setenv(name, value)
    requeue()
    assert (tmp_path / "asked").read_text().strip() == asked


def test_a_job_that_cannot_be_requeued_is_told_of(monkeypatch, caplog):
    monkeypatch.setenv("SLURM_JOB_ID", "77")
    monkeypatch.setenv("PATH", "")
    requeue()
    assert "job 77 could not be requeued" in caplog.text


def test_a_process_that_another_ones_signal_stops_saves_with_it_once(tmp_path):
    keeper, (trainer, steps) = RunCheckpoint(tmp_path / "last.ckpt"), saving(1)
    trainer.strategy.reduce_boolean_decision.side_effect = lambda decision, all: True
    keeper.on_train_batch_end(trainer, Module(), None, None, 0)
    keeper.on_train_end(trainer, Module())
    assert steps == [1] and trainer.should_stop and keeper.stopped_by == "SIGTERM"


@pytest.mark.parametrize("shares", [(1.0,), (0.9, 0.1), (0.0, 0.25, 0.75)])
def test_steps_whose_loss_is_far_above_the_usual_hardly_count(shares):
    """Whichever of the accumulated batches has the loss."""

    def step(skip: SkipOutliers, number: int, loss: float) -> float:
        module = Module()
        module.weight.grad = torch.ones_like(module.weight)
        for share in shares:
            skip.on_before_backward(at(number), module, torch.tensor(share * loss))
        skip.on_before_optimizer_step(at(number), module, torch.optim.SGD([module.weight]))
        return module.weight.grad.item()

    skip = SkipOutliers(window=4, deviations=0.85, after=2)
    history = [1.0, 2.0, 3.0, 2.0]
    assert [step(skip, number, loss) for number, loss in enumerate(history)] == [1.0] * 4
    # Of the four that end with it: an own share in the mean and the deviation raises the limit.
    for loss, kept in ((2.65, 1.0), (3.2, 1e-10)):
        last = [*history[1:], loss]
        assert (loss > np.mean(last) + 0.85 * np.std(last)) == (kept < 1)
        fresh = SkipOutliers(window=4, deviations=0.85, after=2)
        fresh.load_state_dict(skip.state_dict())
        assert step(fresh, 3, loss) == pytest.approx(kept)
    assert skip.history == pytest.approx(history)


class Sleeping(Module):
    """Its second batch takes longer than the run may."""

    def training_step(self, batch: torch.Tensor, batch_idx: int) -> torch.Tensor:
        self.last = batch_idx
        time.sleep(0.2 * (batch_idx == 1))
        return (self.weight * batch).sum()

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD([self.weight], lr=0.1)


def test_a_time_limit_ends_a_start_of_a_run_after_a_whole_step(tmp_path):
    for path, last, step in ((None, 3, 1), (tmp_path / "last.ckpt", 11, 3)):
        trainer = pl.Trainer(
            accelerator="cpu", accumulate_grad_batches=4, max_steps=3, max_epochs=-1,
            callbacks=[StepTimer(timedelta(seconds=0.1)), RunCheckpoint(tmp_path / "last.ckpt")],
            logger=False, enable_checkpointing=False, enable_progress_bar=False, enable_model_summary=False,
        )  # fmt: skip
        with warnings.catch_warnings(action="ignore"):  # Lightning's advice on workers
            trainer.fit(module := Sleeping(), torch.utils.data.DataLoader(torch.ones(12), batch_size=1), ckpt_path=path)
        assert trainer.global_step == step and module.last == last and (tmp_path / "last.ckpt").is_file()


def test_the_schedule_is_the_published_one():
    def rate(step: int, peak: float = 1e-4) -> float:
        return learning_rate(step, peak=peak, total=300_000)

    assert (rate(0), rate(100)) == pytest.approx((1e-6, 1e-4)) and rate(90_000) == pytest.approx(8.15e-5, rel=2e-3)
    assert rate(90_000, 3e-5) == pytest.approx(2.59e-5, rel=2e-3)
    assert rate(400_000) == pytest.approx(1e-5)


def test_every_group_ends_at_one_floor():
    module = nn.Linear(2, 2)
    groups = [{"params": [module.weight], "lr": 1e-2}, {"params": [module.bias], "lr": 1e-3}]
    made = scheduled(torch.optim.SGD(groups), total=10, warmup=2, floor=1e-4)
    for _ in range(12):
        made["optimizer"].step()
        made["lr_scheduler"]["scheduler"].step()
    assert [group["lr"] for group in made["optimizer"].param_groups] == pytest.approx([1e-4, 1e-4])


def test_matrices_decay_and_vectors_do_not():
    module = nn.Sequential(nn.Linear(2, 2), nn.LayerNorm(2))
    module[0].requires_grad_(True)
    module[1].bias.requires_grad_(False)
    matrices, vectors = decayed_groups([module, module], lr=1.0, weight_decay=0.1)
    assert matrices["weight_decay"] == 0.1 and matrices["params"] == [module[0].weight]
    assert vectors["weight_decay"] == 0.0 and len(vectors["params"]) == 2 and len(trainable([module, module])) == 3


def test_the_handler_of_a_launcher_follows_the_checkpoint(tmp_path, monkeypatch):
    """submitit requeues its jobs at SIGUSR2."""
    seen: list[int] = []
    before = signal.signal(signal.SIGUSR2, lambda number, frame: seen.append(number))
    try:
        keeper, (trainer, _) = RunCheckpoint(tmp_path / "last.ckpt"), saving(1)
        keeper.on_train_start(trainer, Module())
        os.kill(os.getpid(), signal.SIGUSR2)
        trainer.global_step = 2
        keeper.on_train_batch_end(trainer, Module(), None, None, 0)
        assert (tmp_path / "last.ckpt").is_file() and seen == []
        keeper.on_train_end(trainer, Module())
        assert seen == [signal.SIGUSR2]
    finally:
        signal.signal(signal.SIGUSR2, before)
