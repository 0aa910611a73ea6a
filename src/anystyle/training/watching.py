"""Callbacks that act on a value that validations log: early stopping, and keeping the best weights."""

import logging
import sys
from collections.abc import Callable
from typing import Any, Literal

from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import EarlyStopping

from anystyle.errors import UserError, check_known

log = logging.getLogger(__name__)


class EarlyStop(EarlyStopping):
    """Lightning's, which ends a run for good: the same command does not go on with it.

    A run whose validations would not log the value is refused, and a validation that only its begin or a stop has
    caused is left out, so that a resumed run ends as an uninterrupted one.
    """

    @property
    def ended(self) -> bool:
        """Whether it has ended the run."""
        return self.stopping_reason_message is not None

    def on_train_start(self, trainer: Any, pl_module: LightningModule) -> None:
        batches = trainer.max_steps * trainer.accumulate_grad_batches
        if trainer.datamodule.validation is None or not trainer.enable_validation or trainer.val_check_batch > batches:
            remedy = "add scenes@validation_scenes=NAME, and trainer.val_check_interval=N, a number of batches"
            raise UserError(f"{self.monitor}: no validation is within the run's {batches} batches; {remedy}")
        trainer.should_stop = trainer.should_stop or self.ended

    def on_validation_end(self, trainer: Any, pl_module: LightningModule) -> None:
        if trainer.sanity_checking or (trainer.fit_loop.total_batch_idx + 1) % trainer.val_check_batch:
            return
        check_known("logged value", [self.monitor], trainer.callback_metrics)
        super().on_validation_end(trainer, pl_module)
        self.judged(trainer)

    def judged(self, trainer: Trainer) -> None:
        """Called after each validation."""
        if self.ended:
            log.warning("step %d: %s", trainer.global_step, self.stopping_reason_message)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        # Lightning takes the patience of the checkpoint; a run may be resumed with more of it.
        super().load_state_dict(state_dict | {"patience": self.patience})
        if self.wait_count < self.patience:
            self.stopping_reason_message = None


class Best(EarlyStop):
    """Calls ``keep`` with the step and the value after each validation that is better than all before it.

    In front of :class:`~anystyle.training.callbacks.MovingAverage`, it keeps the average that was validated.
    """

    def __init__(self, monitor: str, keep: Callable[[int, float], object], mode: Literal["min", "max"] = "min") -> None:
        super().__init__(monitor, mode=mode, patience=sys.maxsize, check_finite=False)
        self.keep = keep

    def judged(self, trainer: Trainer) -> None:
        if self.wait_count == 0 and trainer.is_global_zero:
            self.keep(trainer.global_step, float(self.best_score))
