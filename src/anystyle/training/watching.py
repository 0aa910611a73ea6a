"""Callbacks that act on a value that validations log: early stopping, and keeping the best weights."""

import logging
import math
from collections.abc import Callable
from typing import Any, Literal

from lightning.pytorch import Callback, LightningModule, Trainer
from lightning.pytorch.callbacks import EarlyStopping

from anystyle.errors import UserError, unknown

log = logging.getLogger(__name__)


class Watching(Callback):
    """Acts on the value named ``monitor``; a run whose validations would not log it is refused."""

    monitor: str

    def on_train_start(self, trainer: Any, pl_module: LightningModule) -> None:
        every, batches = trainer.val_check_batch, trainer.max_steps * trainer.accumulate_grad_batches
        if trainer.datamodule.validation is None or not trainer.enable_validation:
            raise UserError(f"{self.monitor}: there is no validation; add scenes@validation_scenes=NAME")
        if every > batches:
            raise UserError(f"{self.monitor}: trainer.val_check_interval={every} is more than all {batches} batches")

    def value(self, trainer: Any) -> float | None:
        """The value just logged; ``None`` of a validation that only the begin or a stop of the run has caused."""
        if trainer.sanity_checking or (trainer.fit_loop.total_batch_idx + 1) % trainer.val_check_batch:
            return None
        if self.monitor not in trainer.callback_metrics:
            raise UserError(unknown("logged value", self.monitor, trainer.callback_metrics))
        return float(trainer.callback_metrics[self.monitor])


class EarlyStop(EarlyStopping, Watching):
    """Lightning's, which ends a run for good: the same command does not go on with it."""

    @property
    def ended(self) -> bool:
        """Whether it has ended the run."""
        return self.stopping_reason_message is not None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        super().on_train_start(trainer, pl_module)
        trainer.should_stop = trainer.should_stop or self.ended

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        if self.value(trainer) is None:
            return
        super().on_validation_end(trainer, pl_module)
        if self.ended:
            log.warning("step %d: %s", trainer.global_step, self.stopping_reason_message)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        # Lightning takes the patience of the checkpoint; a run may be resumed with more of it.
        super().load_state_dict(state_dict | {"patience": self.patience})
        if self.wait_count < self.patience:
            self.stopping_reason_message = None


class Best(Watching):
    """Calls ``keep`` with the step and the value after each validation that is better than all before it.

    In front of :class:`~anystyle.training.callbacks.MovingAverage`, it keeps the average that was validated.
    """

    def __init__(self, monitor: str, keep: Callable[[int, float], object], mode: Literal["min", "max"] = "min") -> None:
        self.monitor, self.keep, self.sign = monitor, keep, 1 if mode == "min" else -1
        self.lowest = math.inf

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        value = self.value(trainer)
        if value is not None and self.sign * value < self.lowest:
            self.lowest = self.sign * value
            if trainer.is_global_zero:
                self.keep(trainer.global_step, value)

    @property
    def state_key(self) -> str:
        return self._generate_state_key(monitor=self.monitor, sign=self.sign)

    def state_dict(self) -> dict[str, Any]:
        return {"lowest": self.lowest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.lowest = state_dict["lowest"]
