"""What a run needs besides its maths: seeds, checkpoints, averages and signs of life."""

import logging
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor, nn

from anystyle.errors import one_line
from anystyle.files import atomic_path

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
        """Seed."""
        mixed = 0
        for word in (self.seed, batch_idx, trainer.global_rank):
            # SplitMix64: near words give unrelated seeds.
            mixed = (mixed + word + 0x9E3779B97F4A7C15) % 2**64
            mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
            mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) % 2**64
            mixed ^= mixed >> 31
        torch.manual_seed(mixed % 2**63)


class LastCheckpoint(pl.Callback):
    """Keep one checkpoint that a run can be continued from, and write it before an orderly end.

    The file is written beside its place and then takes its name, so that a kill or a full disk leaves the last good
    one. SIGTERM and the first Ctrl-C end the run after the current step.

    Args:
        path: Where it goes.
        every_steps: Steps between two writings.
        every_minutes: Minutes between two writings, whichever comes first.
    """

    def __init__(self, path: str | Path, *, every_steps: int = 500, every_minutes: float = 5.0) -> None:
        self.path = Path(path)
        self.every_steps, self.every_seconds = every_steps, 60 * every_minutes
        self.stopped_by: str | None = None
        self._written = time.monotonic()
        self._previous: dict[signal.Signals, Any] = {}

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Listen to signals, in place of Lightning's own handler, which would end the run without saving."""
        self._written = time.monotonic()
        if threading.current_thread() is threading.main_thread():
            for name in (signal.SIGTERM, signal.SIGINT):
                self._previous[name] = signal.signal(name, self._stop)

    def _stop(self, number: int, frame: Any) -> None:
        name = signal.Signals(number)
        self.stopped_by = name.name
        # A second Ctrl-C ends at once.
        if name is signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Save if it is time, or if the run is to end."""
        stop = trainer.strategy.reduce_boolean_decision(self.stopped_by is not None, all=False)
        step = trainer.global_step
        late = trainer.strategy.reduce_boolean_decision(
            time.monotonic() - self._written > self.every_seconds, all=False
        )
        if stop or late or step % self.every_steps == 0:
            self.save(trainer)
        if stop:
            log.warning("stopped by %s after step %d; the same command continues", self.stopped_by, step)
            trainer.should_stop = True

    def on_train_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Save where the run ended."""
        self._restore()
        if trainer.global_step and self.stopped_by is None:
            self.save(trainer)

    def on_exception(self, trainer: pl.Trainer, pl_module: pl.LightningModule, exception: BaseException) -> None:
        """Give the signals back; the last checkpoint stays as it is."""
        self._restore()

    def save(self, trainer: pl.Trainer) -> None:
        """Write the checkpoint; all processes take part, the first one writes.

        Raises:
            OSError: It cannot be written, as on a full disk; the one before it stays.
        """
        try:
            with _atomic_on_first(trainer, self.path) as temporary:
                trainer.save_checkpoint(temporary)
        except OSError as error:
            kept = "the last one stays and " if self.path.is_file() else ""
            raise OSError(
                f"the checkpoint of step {trainer.global_step} cannot be written to {self.path.parent} "
                f"({error.strerror or one_line(error)}); {kept}the same command continues once there is room"
            ) from error
        self._written = time.monotonic()

    def _restore(self) -> None:
        while self._previous:
            signal.signal(*self._previous.popitem())


@contextmanager
def _atomic_on_first(trainer: pl.Trainer, path: Path) -> Iterator[Path]:
    if trainer.is_global_zero:
        with atomic_path(path) as temporary:
            yield temporary
    else:
        yield path


class Average(pl.Callback):
    """An exponential moving average of the trainable weights, used for validation and for what is exported.

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
        """Move the average toward the weights."""
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
                kept = parameter.detach().clone()
                parameter.copy_(self.weights[name])
                self.weights[name] = kept

    def state_dict(self) -> dict[str, Any]:
        """The average."""
        return {"weights": self.weights}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take an average up again."""
        self.weights = dict(state_dict["weights"])


def _trainable(module: nn.Module) -> list[tuple[str, nn.Parameter]]:
    return [(name, parameter) for name, parameter in module.named_parameters() if parameter.requires_grad]


class Lines(pl.Callback):
    """A line of text every so often, where there is no terminal to draw a progress bar on.

    Args:
        every_seconds: At least so long between two lines.
        write: Where the line goes.
    """

    def __init__(self, every_seconds: float = 30.0, write: Callable[[str], Any] = sys.stderr.write) -> None:
        self.every_seconds, self.write = every_seconds, write
        self._last = self._start = time.monotonic()
        self._first_step = 0

    def on_train_start(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Start the clock."""
        self._last = self._start = time.monotonic()
        self._first_step = trainer.global_step

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Say where the run is."""
        now, step, total = time.monotonic(), trainer.global_step, trainer.max_steps
        if not trainer.is_global_zero or (now - self._last < self.every_seconds and step < total):
            return
        self._last = now
        speed = (now - self._start) / max(1, step - self._first_step)
        loss = trainer.callback_metrics.get("train/loss")
        text = f"step {step}/{total}" + ("" if loss is None else f"  loss {float(loss):.4f}")
        self.write(f"{text}  {speed:.3f} s/step  {speed * (total - step) / 60:.1f} min left\n")

    def on_validation_end(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Say what validation found."""
        found = {name: float(value) for name, value in trainer.callback_metrics.items() if name.startswith("val/")}
        if found and trainer.is_global_zero and not trainer.sanity_checking:
            self.write("  ".join(f"{name} {value:.4g}" for name, value in sorted(found.items())) + "\n")
