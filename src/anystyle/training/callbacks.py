"""What a run needs besides its maths: seeds, checkpoints, an average of the weights, and lines of progress."""

import logging
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import lightning.pytorch as pl
import torch
from torch import Tensor, nn

from anystyle.errors import one_line
from anystyle.io.atomic import atomic_path
from anystyle.training.resume import before
from anystyle.training.sampling import generator

log = logging.getLogger(__name__)


class StepSeed(pl.Callback):
    """Seed the global generators before every step with the run's seed, the step and the rank.

    A step's randomness is then a function of the step, and a continued run needs no generator's state.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def on_train_batch_start(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        torch.manual_seed(int(generator(self.seed, batch_idx, trainer.global_rank).integers(2**63)))


class LastCheckpoint(pl.Callback):
    """Keep one checkpoint that a run can be continued from, and write it before an orderly end.

    The file is written beside its final name and then renamed, so that a kill or a full disk leaves the last good one;
    the one before it is kept beside it.
    SIGTERM and the first Ctrl-C end the run after the current optimizer step.

    Lightning's ``ModelCheckpoint`` does not serve: one of them counts steps or minutes, not both; none writes at the
    end or at a signal; and it writes through the system's temporary folder, from where a file is not renamed but
    copied if that is another disk.

    Args:
        path: Of the checkpoint.
        every_steps: Optimizer steps between two writings.
        every_minutes: Minutes between two writings, whichever comes first.
    """

    def __init__(self, path: str | Path, *, every_steps: int = 500, every_minutes: float = 5.0) -> None:
        self.path = Path(path)
        self.every_steps, self.every_seconds = every_steps, 60 * every_minutes
        self.stopped_by: str | None = None
        self.started = False
        self.metrics: dict[str, float] = {}
        self._saved_at = time.monotonic()
        self._step = 0
        self._previous: dict[signal.Signals, Any] = {}

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Handle signals, in place of Lightning's own handler, which would end the run without saving."""
        self.started = True
        self._saved_at, self._step = time.monotonic(), trainer.global_step
        if threading.current_thread() is threading.main_thread():
            for name in (signal.SIGTERM, signal.SIGINT):
                self._previous[name] = signal.signal(name, self._stop)

    def _stop(self, signum: int, frame: Any) -> None:
        received = signal.Signals(signum)
        self.stopped_by = received.name
        # A second Ctrl-C ends at once.
        if received is signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Save if it is time, or if the run is to end."""
        # A checkpoint holds no gradients: nothing is saved while those of several batches are accumulated.
        if trainer.global_step == self._step:
            return
        self._step = trainer.global_step
        stop = trainer.strategy.reduce_boolean_decision(self.stopped_by is not None, all=False)
        late = trainer.strategy.reduce_boolean_decision(
            time.monotonic() - self._saved_at > self.every_seconds, all=False
        )
        if stop or late or self._step % self.every_steps == 0:
            self.save(trainer)
        if stop:
            log.warning("stopped by %s after step %d; the same command continues", self.stopped_by, self._step)
            trainer.should_stop = True

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        self._restore()
        if trainer.global_step and self.stopped_by is None:
            self.save(trainer)

    def on_exception(self, trainer: pl.Trainer, pl_module: pl.LightningModule, exception: BaseException) -> None:
        """Restore the signal handlers; the last checkpoint stays as it is."""
        self._restore()

    def save(self, trainer: pl.Trainer) -> None:
        """Write the checkpoint; all processes take part, the first one writes.

        Raises:
            OSError: It cannot be written, as on a full disk; the one before it stays.
        """
        self.metrics |= logged(trainer)
        try:
            with _atomic_on_first(trainer, self.path) as temporary:
                trainer.save_checkpoint(temporary)
                if trainer.is_global_zero and self.path.is_file():
                    self.path.replace(before(self.path))
        except OSError as error:
            kept = "the last one stays and " if self.path.is_file() else ""
            raise OSError(
                f"the checkpoint of step {trainer.global_step} cannot be written to {self.path.parent} "
                f"({error.strerror or one_line(error)}); {kept}the same command continues once there is room"
            ) from error
        self._saved_at = time.monotonic()

    def state_dict(self) -> dict[str, Any]:
        """The last values logged, which belong to the checkpoint."""
        return {"metrics": self.metrics}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.metrics = dict(state_dict["metrics"])

    def _restore(self) -> None:
        while self._previous:
            signal.signal(*self._previous.popitem())


def logged(trainer: pl.Trainer) -> dict[str, float]:
    """The last values logged."""
    return {name: float(value) for name, value in trainer.callback_metrics.items()}


@contextmanager
def _atomic_on_first(trainer: pl.Trainer, path: Path) -> Iterator[Path]:
    if trainer.is_global_zero:
        with atomic_path(path, sync=True) as temporary:
            yield temporary
    else:
        yield path


class Average(pl.Callback):
    """An exponential moving average of the trainable weights, used for validation and for what is exported.

    Lightning's ``WeightAveraging`` copies the whole module, the frozen networks and the data that it reads included,
    and writes the frozen weights into every checkpoint. This one keeps what learns alone.

    Args:
        decay: Of the average; early on it is ``(1 + step) / (10 + step)``, so that it is not slow to start.
    """

    def __init__(self, decay: float = 0.999) -> None:
        self.decay = decay
        self.weights: dict[str, Tensor] = {}

    @torch.no_grad()
    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        step = trainer.global_step
        decay = min(self.decay, (1 + step) / (10 + step))
        for name, parameter in _trainable(pl_module):
            if name not in self.weights:
                self.weights[name] = parameter.detach().clone()
            else:
                self.weights[name].lerp_(parameter.detach(), 1 - decay)

    def on_validation_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Validate the average."""
        self.swap(pl_module)

    def on_validation_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Go on with the weights."""
        self.swap(pl_module)

    @torch.no_grad()
    def swap(self, module: nn.Module) -> None:
        """Exchange the average and the weights; twice is not at all."""
        for name, parameter in _trainable(module):
            if name in self.weights:
                current = parameter.detach().clone()
                parameter.copy_(self.weights[name])
                self.weights[name] = current

    def state_dict(self) -> dict[str, Any]:
        return {"weights": self.weights}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.weights = dict(state_dict["weights"])


def _trainable(module: nn.Module) -> list[tuple[str, nn.Parameter]]:
    return [(name, parameter) for name, parameter in module.named_parameters() if parameter.requires_grad]


class ProgressLines(pl.Callback):
    """Lines of progress, where there is no terminal to draw a progress bar on."""

    def __init__(self, every_seconds: float = 30.0, write: Callable[[str], Any] = sys.stderr.write) -> None:
        self.every_seconds, self.write = every_seconds, write
        self._last = self._start = time.monotonic()
        self._first_step = 0

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        self._last = self._start = time.monotonic()
        self._first_step = trainer.global_step

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Write the step, the loss, the speed and the time left."""
        now, step, total = time.monotonic(), trainer.global_step, trainer.max_steps
        if not trainer.is_global_zero or (now - self._last < self.every_seconds and step < total):
            return
        self._last = now
        speed = (now - self._start) / max(1, step - self._first_step)
        loss = trainer.callback_metrics.get("train/loss")
        text = f"step {step}/{total}" + ("" if loss is None else f"  loss {float(loss):.4f}")
        self.write(f"{text}  {speed:.3f} s/step  {speed * (total - step) / 60:.1f} min left\n")

    def on_validation_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Write the metrics of a validation."""
        metrics = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
        if metrics and trainer.is_global_zero:
            self.write("  ".join(f"{name} {value:.4g}" for name, value in sorted(metrics.items())) + "\n")


@runtime_checkable
class Counted(Protocol):
    """A batch that knows how many images it holds."""

    @property
    def num_images(self) -> int:
        """Images that the networks see in this process."""
        ...


def num_images(batch: Any) -> int:
    """Images of a batch that the networks see in this process; 1 of a batch that does not say."""
    return batch.num_images if isinstance(batch, Counted) else 1


class SkippedData(pl.Callback):
    """Count what could not be read and was drawn anew, and keep a list of it.

    Args:
        path: A text file with one line for each, in the order in which they were met.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.lines: dict[str, int] = {}

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Take down what this batch does without."""
        skipped = batch.skipped if isinstance(batch, Incomplete) else ()
        pl_module.log("data/skipped", float(sum(self.lines.values()) + len(skipped)))
        if not skipped:
            return
        new = [line for line in skipped if line not in self.lines]
        for line in skipped:
            self.lines[line] = self.lines.get(line, 0) + 1
        if new:
            # Each process sees its own share of the data.
            path = (
                self.path if trainer.is_global_zero else self.path.with_stem(f"{self.path.stem}_{trainer.global_rank}")
            )
            with atomic_path(path) as temporary:
                temporary.write_text("".join(f"{line}\n" for line in self.lines), encoding="utf-8")

    def state_dict(self) -> dict[str, Any]:
        return {"seen": self.lines}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.lines = dict(state_dict["seen"])


@runtime_checkable
class Incomplete(Protocol):
    """A batch that knows what was left out of it."""

    @property
    def skipped(self) -> tuple[str, ...]:
        """A line for each scene or style that was drawn and could not be read."""
        ...
