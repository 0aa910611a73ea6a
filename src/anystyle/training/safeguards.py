"""Callbacks that keep one bad batch from spoiling a run."""

import math
from collections import deque
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from torch import Tensor, nn
from torch.distributed.tensor import DTensor

from anystyle.io.atomic import atomic_path


class FiniteLoss(pl.Callback):
    """Stop a run whose loss or gradient is no number or explodes, and keep the batch that did it.

    Args:
        path: File of the batch; processes of rank above 0 append their rank to the name.
        growth: A loss above this multiple of the mean of the last hundred stops the run; ``None`` allows any.
        max_gradient: A gradient norm above this stops the run too; ``None`` allows any finite one.
    """

    def __init__(self, path: str | Path, *, growth: float | None = None, max_gradient: float | None = None) -> None:
        if growth is not None and growth <= 1:
            raise ValueError(f"explosion={growth}: a loss may vary; give a factor above 1, such as 1000, or null")
        self.path = Path(path)
        self.growth, self.max_gradient = growth, max_gradient
        self._batch: Any = None
        self._recent: deque[float] = deque(maxlen=100)

    def on_train_batch_start(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, batch: Any, batch_idx: int
    ) -> None:
        self._batch = batch

    def on_before_backward(self, trainer: pl.Trainer, pl_module: pl.LightningModule, loss: Tensor) -> None:
        value = float(loss.detach())
        usual = sum(self._recent) / len(self._recent) if len(self._recent) >= 20 else math.inf
        if not math.isfinite(value):
            problem = f"the loss is {value}"
        elif self.growth is not None and abs(value) > self.growth * max(usual, 1e-12):
            problem = f"the loss is {value:g}, {abs(value) / max(usual, 1e-12):.0f} times the usual"
        else:
            problem = ""
        self._recent.append(abs(value))
        self._refuse(trainer, problem)

    def on_before_optimizer_step(
        self, trainer: pl.Trainer, pl_module: pl.LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        """Check the gradient, and log its norm."""
        norm = gradient_norm(pl_module)
        pl_module.log("train/gradient_norm", norm)
        if not torch.isfinite(norm) or (self.max_gradient is not None and norm > self.max_gradient):
            self._refuse(trainer, f"the gradient's norm is {norm.item():g}")

    def _refuse(self, trainer: pl.Trainer, problem: str) -> None:
        # Processes stop together, for one that goes on waits for the others' gradients for ever. After the gradients
        # are averaged all of them see the same.
        if not trainer.strategy.reduce_boolean_decision(bool(problem), all=False):
            return
        rank = trainer.global_rank
        path = self.path if rank == 0 else self.path.with_stem(f"{self.path.stem}_{rank}")
        with atomic_path(path) as temporary:
            torch.save({"step": trainer.global_step, "batch": self._batch}, temporary)
        raise ValueError(
            f"at step {trainer.global_step} {problem or 'another process met a bad loss'}; the batch is in {path}. "
            f"Lower training.learning_rate, or continue from the last checkpoint with another seed"
        )


def gradient_norm(module: nn.Module) -> Tensor:
    """The norm of all gradients together."""
    norms = [_full(parameter.grad.norm()) for parameter in module.parameters() if parameter.grad is not None]
    return torch.stack(norms).norm() if norms else torch.zeros(())


def _full(value: Tensor) -> Tensor:
    """A number of a sharded run from the shards of all processes."""
    return value.full_tensor() if isinstance(value, DTensor) else value


class SkipOutliers(pl.Callback):
    """The reference's rule for losses far above the usual: their gradients count for almost nothing.

    From step ``after`` on, a loss above ``mean + deviations * std`` of the last ``window`` losses has its gradient
    scaled by 1e-10; the optimiser's averages and the weight decay still move, as in the published code.

    Args:
        window: Losses remembered; the rule sleeps until there are so many.
        deviations: Of the mean, in population standard deviations.
        after: The first step at which it applies.
    """

    def __init__(self, *, window: int = 500, deviations: float = 0.85, after: int = 3000) -> None:
        self.window, self.deviations, self.after = window, deviations, after
        self.history: list[float] = []
        self._skip = False

    def on_before_backward(self, trainer: pl.Trainer, pl_module: pl.LightningModule, loss: Tensor) -> None:
        value = float(loss.detach())
        self._skip = False
        if len(self.history) == self.window:
            mean = sum(self.history) / self.window
            deviation = (sum((past - mean) ** 2 for past in self.history) / self.window) ** 0.5
            self._skip = trainer.global_step > self.after and value > mean + self.deviations * deviation
        self.history = [*self.history, value][-self.window :]

    @torch.no_grad()
    def on_after_backward(self, trainer: pl.Trainer, pl_module: pl.LightningModule) -> None:
        """Scale the gradients of a skipped step."""
        if self._skip:
            for parameter in pl_module.parameters():
                if parameter.grad is not None:
                    parameter.grad.mul_(1e-10)

    def state_dict(self) -> dict[str, Any]:
        return {"history": self.history}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.history = list(state_dict["history"])
