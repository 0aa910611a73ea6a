"""What a run logs beside its losses: the size of its batches, and data that could not be read."""

from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import lightning.pytorch as pl

from anystyle.io.atomic import atomic_path


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
