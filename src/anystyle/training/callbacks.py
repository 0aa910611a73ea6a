"""Callbacks of every run: seeds, checkpoints, a moving average of the weights, and lines of progress."""

import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.utilities.throughput import Throughput
from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import ThroughputMonitor, Timer
from torch import Tensor, nn

from anystyle.errors import UserError, one_line
from anystyle.io.atomic import atomic_path
from anystyle.training.resume import previous
from anystyle.training.sampling import generator

log = logging.getLogger(__name__)


class StepSeed(Callback):
    """Seed the global generators before every step with the run's seed and the step, alike in all processes.

    A step's randomness is then a function of the step, and a resumed run needs no generator's state.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        torch.manual_seed(int(generator(self.seed, batch_idx, 0).integers(2**63)))

    def on_validation_batch_start(self, trainer: Trainer, pl_module: LightningModule, *batch: Any, **_: Any) -> None:
        self.on_train_batch_start(trainer, pl_module, *batch[:2])  # validations differ by the weights alone


def ends_step(trainer: Trainer, batch_idx: int) -> bool:
    """Whether the optimizer steps after a batch, and not after later ones whose gradients are added to its own."""
    return (batch_idx + 1) % trainer.accumulate_grad_batches == 0


class StepTimer(Timer):
    """Lightning's, which ends a run after an optimizer step only: a checkpoint holds no gradients of a part of one."""

    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        if ends_step(trainer, batch_idx):
            super().on_train_batch_end(trainer, pl_module, outputs, batch, batch_idx)

    def state_dict(self) -> dict[str, Any]:
        """Nothing: each start of a run has the time anew, so that the same command goes on."""
        return {}


class StepThroughput(ThroughputMonitor):
    """Lightning's, whose ``samples`` count those of all processes, which have equally many."""

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        super().setup(trainer, pl_module, stage)
        for key in self._throughputs:
            self._throughputs[key] = _AllSamples(world_size=trainer.world_size, **self.kwargs)


class _AllSamples(Throughput):
    def compute(self) -> dict[str, int | float]:
        values = super().compute()
        return values | {"samples": values["samples"] * self.world_size} if "samples" in values else values


STOPS = tuple(each for each in signal.Signals if each.name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGUSR1", "SIGUSR2"))
"""Signals at which a training saves and ends; Windows lacks some of them."""


def requeue() -> None:
    """Put the Slurm job that this process runs in back into the queue; outside of one nothing is done."""
    job = os.environ.get("SLURM_JOB_ID")
    if job is None:
        return
    if task := os.environ.get("SLURM_ARRAY_TASK_ID"):
        job = f"{os.environ['SLURM_ARRAY_JOB_ID']}_{task}"
    try:
        subprocess.run(["scontrol", "requeue", job], check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        log.warning("Slurm's job %s could not be requeued (%s); submit it again to resume", job, one_line(error))


class RunCheckpoint(Callback):
    """Save a checkpoint every so many steps or minutes, at the end, and when a signal stops the run.

    The file is written beside its final name and then renamed, so that a kill or a full disk leaves the last good one;
    the one before it is kept beside it. The signals :data:`STOPS` and the first Ctrl-C end the run after the current
    optimizer step; at SIGUSR1 within a Slurm job it is put back into the queue, as Lightning would.

    Lightning's ``ModelCheckpoint`` counts either steps or minutes, saves at a signal only in the middle of a step
    (from which a run is not resumed bit for bit), and does not rename atomically.

    Args:
        path: The last checkpoint.
        every_steps: Optimizer steps between two.
        every_minutes: Minutes between two.
        check: Called before each is written; raises an error where the folder belongs to another run by now.
        watched: Whether callbacks before it act on validations: what they learn is saved with the step.
    """

    def __init__(
        self,
        path: Path,
        *,
        every_steps: int = 500,
        every_minutes: float = 5.0,
        check: Callable[[], None] = lambda: None,
        watched: bool = False,
    ) -> None:
        self.path, self.every_steps, self.every_seconds, self.check = path, every_steps, 60 * every_minutes, check
        self.watched = watched
        self.stopped_by: str | None = None
        self.started = self._saved = self._before_validation = False
        self.metrics: dict[str, float] = {}
        self._saved_at = time.monotonic()
        self._step = 0
        self._handlers: dict[signal.Signals, Any] = {}

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.started = True
        self._saved_at, self._step = time.monotonic(), trainer.global_step
        # In place of Lightning's own handler, which would end the run without saving.
        if threading.current_thread() is threading.main_thread():
            for name in STOPS:
                if name.name != "SIGHUP" or signal.getsignal(name) != signal.SIG_IGN:  # nohup
                    self._handlers[name] = signal.signal(name, self._stop)

    def _stop(self, signum: int, frame: Any) -> None:
        self.stopped_by = signal.Signals(signum).name
        if signum == signal.SIGINT:  # a second Ctrl-C ends at once
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any, **__: Any) -> None:
        self._before_validation = False
        # A checkpoint holds no gradients: nothing is saved while those of several batches are accumulated.
        if trainer.global_step == self._step:
            return
        self._step = trainer.global_step
        agree = trainer.strategy.reduce_boolean_decision
        stop = agree(self.stopped_by is not None, all=False)
        late = agree(time.monotonic() - self._saved_at > self.every_seconds, all=False)
        if stop or late or self._step % self.every_steps == 0:
            self.save(trainer)
            self._before_validation = True
        if stop:
            self._saved = True
            self.stopped_by = self.stopped_by or "SIGTERM"  # of another process
            log.warning("stopped by %s after step %d; the same command resumes", self.stopped_by, self._step)
            trainer.should_stop = True
            if self.stopped_by == "SIGUSR1" and trainer.is_global_zero:
                requeue()

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        # Lightning does not repeat this validation after a resume: the state of those that act on it is saved.
        if self._before_validation and self.watched:
            self.save(trainer)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._restore_handlers()
        if trainer.global_step and not self._saved:  # alike in all processes, which save together
            self.save(trainer)
        if self.stopped_by == "SIGUSR2" and callable(signal.getsignal(signal.SIGUSR2)):
            signal.raise_signal(signal.SIGUSR2)  # of submitit, which puts its job back into the queue

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        self._restore_handlers()

    def _restore_handlers(self) -> None:
        while self._handlers:
            signal.signal(*self._handlers.popitem())

    def save(self, trainer: Trainer) -> None:
        """Write the checkpoint; all processes take part, the first one writes."""
        self.check()
        self.metrics |= logged(trainer)
        try:
            with atomic_path(self.path, sync=True) if trainer.is_global_zero else nullcontext(self.path) as temporary:
                trainer.save_checkpoint(temporary)
                if trainer.is_global_zero and self.path.is_file():
                    self.path.replace(previous(self.path))
        except OSError as error:
            stays = "the last one stays and " if self.path.is_file() else ""
            raise UserError(
                f"the checkpoint of step {trainer.global_step} cannot be written to {self.path.parent} "
                f"({error.strerror or one_line(error)}); {stays}the same command resumes once there is room"
            ) from error
        self._saved_at = time.monotonic()

    def state_dict(self) -> dict[str, Any]:
        return {"metrics": self.metrics}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.metrics = dict(state_dict["metrics"])


def logged(trainer: Trainer) -> dict[str, float]:
    """The last values logged."""
    return {name: float(value) for name, value in trainer.callback_metrics.items()}


class MovingAverage(Callback):
    """An exponential moving average of the trainable weights over steps, which is validated and exported.

    The decay begins at ``(1 + step) / (10 + step)``, so that the average is not slow to start. Lightning's
    ``EMAWeightAveraging`` copies the whole module, frozen networks included, into every checkpoint.
    """

    def __init__(self, decay: float = 0.999) -> None:
        self.decay = decay
        self.weights: dict[str, Tensor] = {}

    @torch.no_grad()
    def on_train_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        if not ends_step(trainer, batch_idx):
            return
        decay = min(self.decay, (1 + trainer.global_step) / (10 + trainer.global_step))
        for name, parameter in _trainable(pl_module).items():
            if name in self.weights:
                self.weights[name].lerp_(parameter.detach(), 1 - decay)
            else:
                self.weights[name] = parameter.detach().clone()

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.swap(pl_module)

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self.swap(pl_module)

    @torch.no_grad()
    def swap(self, module: nn.Module) -> None:
        """Swap the averaged and the current weights; a second call restores them."""
        parameters = _trainable(module)
        for name, average in self.weights.items():
            self.weights[name] = parameters[name].detach().clone()
            parameters[name].copy_(average)

    def state_dict(self) -> dict[str, Any]:
        return {"weights": self.weights}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.weights = dict(state_dict["weights"])


def _trainable(module: nn.Module) -> dict[str, nn.Parameter]:
    return {name: parameter for name, parameter in module.named_parameters() if parameter.requires_grad}


class ProgressLines(Callback):
    """A line of progress every 30 seconds, where there is no terminal to draw a progress bar on."""

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._last = self._start = time.monotonic()
        self._first_step = trainer.global_step

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any, **__: Any) -> None:
        now, step, total = time.monotonic(), trainer.global_step, trainer.max_steps
        if not trainer.is_global_zero or (now - self._last < 30 and step < total):
            return
        self._last = now
        pace = (now - self._start) / max(1, step - self._first_step)
        loss = trainer.callback_metrics.get("train/loss")
        text = f"step {step}/{total}" + ("" if loss is None else f"  loss {float(loss):.4f}")
        sys.stderr.write(f"{text}  {pace:.3f} s/step  {pace * (total - step) / 60:.1f} min left\n")

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        metrics = {name: value for name, value in logged(trainer).items() if name.startswith("val/")}
        if metrics and trainer.is_global_zero:
            sys.stderr.write("  ".join(f"{name} {value:.4g}" for name, value in sorted(metrics.items())) + "\n")
