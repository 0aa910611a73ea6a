"""What one wants to see of a run beside its losses: rates, speed, and what the data could not give."""

import time
from collections import deque
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import lightning.pytorch as pl
import torch

from anystyle.files import atomic_path


@runtime_checkable
class Counted(Protocol):
    """A batch that knows how many images it holds."""

    @property
    def num_images(self) -> int:
        """Images that the networks see in this process."""
        ...


class Vitals(pl.Callback):
    """Log the learning rate of every group, and images a second over all processes.

    The names of what depends on the clock begin with ``speed/``, so that results can leave them out.

    Args:
        window: Steps that the speed is a mean of.
    """

    def __init__(self, window: int = 20) -> None:
        self.window = window
        self._done: deque[tuple[float, int]] = deque(maxlen=window + 1)

    def on_before_optimizer_step(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        """Log the rates that this step is made with."""
        for place, group in enumerate(optimizer.param_groups):
            name = str(group.get("name", place)).replace(" ", "_")
            pl_module.log(f"lr/{name}", float(group["lr"]))

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Log the speed of the last steps, waiting for data included."""
        images = batch.num_images if isinstance(batch, Counted) else 0
        self._done.append((time.perf_counter(), images * trainer.world_size))
        if len(self._done) < 2:
            return
        seconds = self._done[-1][0] - self._done[0][0]
        pl_module.log("speed/steps_per_second", (len(self._done) - 1) / seconds)
        seen = sum(count for _, count in list(self._done)[1:])
        if seen:
            pl_module.log("speed/images_per_second", seen / seconds)


class SkippedData(pl.Callback):
    """Count what could not be read and was drawn anew, and keep a list of it.

    Args:
        path: A text file with one line for each, in the order in which they were met.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.seen: dict[str, int] = {}

    def on_train_batch_end(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, outputs: Any, batch: Any, batch_idx: int
    ) -> None:
        """Take down what this batch does without."""
        skipped = batch.skipped if isinstance(batch, Incomplete) else ()
        pl_module.log("data/skipped", float(sum(self.seen.values()) + len(skipped)))
        if not skipped:
            return
        new = [line for line in skipped if line not in self.seen]
        for line in skipped:
            self.seen[line] = self.seen.get(line, 0) + 1
        if new:
            # Each process sees its own share of the data.
            path = (
                self.path if trainer.is_global_zero else self.path.with_stem(f"{self.path.stem}_{trainer.global_rank}")
            )
            with atomic_path(path) as temporary:
                temporary.write_text("".join(f"{line}\n" for line in self.seen), encoding="utf-8")

    def state_dict(self) -> dict[str, Any]:
        """What was met so far."""
        return {"seen": self.seen}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on counting."""
        self.seen = dict(state_dict["seen"])


@runtime_checkable
class Incomplete(Protocol):
    """A batch that knows what was left out of it."""

    @property
    def skipped(self) -> tuple[str, ...]:
        """A line for each scene or style that was drawn and could not be read."""
        ...
