"""Callbacks against bad batches: non-finite or exploding losses, and outliers."""

import math
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning.pytorch import Callback, LightningModule, Trainer
from torch import Tensor, nn
from torch.nn.modules.module import register_module_forward_hook
from torch.nn.utils import get_total_norm

from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path


class FiniteLoss(Callback):
    """Stop a run whose loss or gradient is not finite, or whose loss explodes, and write the batch to ``path``.

    A loss explodes if it is more than ``growth`` times the mean of the last hundred; ``None`` allows any. ``refusal``
    is what to raise in place of an error that came of numbers which were not finite before there was a loss.
    """

    def __init__(self, path: Path, *, growth: float | None = None) -> None:
        self.path, self.growth = path, growth
        self.refusal: UserError | None = None
        self._batch: Any = None
        self._recent: deque[float] = deque(maxlen=100)

    def on_train_batch_start(self, trainer: Trainer, pl_module: LightningModule, batch: Any, batch_idx: int) -> None:
        self._batch = batch

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        value = float(loss.detach())
        usual = max(sum(self._recent) / len(self._recent), 1e-12) if len(self._recent) >= 20 else math.inf
        problem = ""
        if not math.isfinite(value):
            problem = f"the loss is {value}"
        elif self.growth is not None and abs(value) > self.growth * usual:
            problem = f"the loss is {value:g}, {abs(value) / usual:.0f} times the usual"
        self._recent.append(abs(value))
        self._refuse(trainer, problem)

    def on_before_optimizer_step(
        self, trainer: Trainer, pl_module: LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        norm = get_total_norm([parameter.grad for parameter in pl_module.parameters() if parameter.grad is not None])
        pl_module.log("train/gradient_norm", norm)
        if not torch.isfinite(norm):
            self._refuse(trainer, f"the norm of the gradient is {norm.item():g}")

    def _refuse(self, trainer: Trainer, problem: str) -> None:
        # Processes stop together, because one that goes on would wait for the others' gradients for ever. Averaged
        # gradients are the same in all of them.
        if trainer.strategy.reduce_boolean_decision(bool(problem), all=False):
            raise self._keep(trainer, problem or "another process met a bad loss")

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Decompositions, indices and checks may refuse what a network gives before its loss is known: look again."""
        unrelated = isinstance(exception, OSError) or not isinstance(exception, Exception)
        if self._batch is None or self.refusal or unrelated:
            return
        broken: list[nn.Module] = []

        def look(module: nn.Module, given: Any, output: Any) -> None:
            if isinstance(output, Tensor) and not output.isfinite().all():
                broken.append(module)

        computing = trainer.precision_plugin.train_step_context()
        with register_module_forward_hook(look), computing, torch.no_grad(), suppress(Exception):
            pl_module.training_step(self._batch, 0)
        if broken:
            name = next((name for name, module in pl_module.named_modules() if module is broken[0]), "a network")
            self._keep(trainer, f"what {name} computes is not finite")

    def _keep(self, trainer: Trainer, problem: str) -> UserError:
        rank = trainer.global_rank
        path = self.path.with_stem(f"{self.path.stem}_{rank}") if rank else self.path
        with atomic_path(path) as temporary:
            torch.save({"step": trainer.global_step, "batch": self._batch}, temporary)
        self.refusal = UserError(
            f"at step {trainer.global_step} {problem}; the batch is in {path}. "
            f"Lower training.learning_rate, or resume from the last checkpoint with another seed"
        )
        return self.refusal


class SkipOutliers(Callback):
    """Scale the gradients of steps with outlying losses by 1e-10, as the published code does.

    After step ``after``, an outlier is a loss above ``mean + deviations * std`` of the last ``window`` losses, its own
    with them. The optimiser's averages and the weight decay still move.
    """

    def __init__(self, *, window: int = 500, deviations: float = 0.85, after: int = 3000) -> None:
        self.window, self.deviations, self.after = window, deviations, after
        self.history: list[float] = []
        self._batches: list[float] = []

    def on_before_backward(self, trainer: Trainer, pl_module: LightningModule, loss: Tensor) -> None:
        self._batches.append(float(loss.detach()))  # of accumulated batches: its share in the step's

    @torch.no_grad()
    def on_before_optimizer_step(
        self, trainer: Trainer, pl_module: LightningModule, optimizer: torch.optim.Optimizer
    ) -> None:
        self.history = [*self.history, sum(self._batches)][-self.window :]
        self._batches = []
        limit = np.mean(self.history) + self.deviations * np.std(self.history)
        if len(self.history) < self.window or trainer.global_step <= self.after or self.history[-1] <= limit:
            return
        for parameter in pl_module.parameters():
            if parameter.grad is not None:
                parameter.grad.mul_(1e-10)

    def state_dict(self) -> dict[str, Any]:
        return {"history": self.history}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.history = list(state_dict["history"])
