"""Work inside a node: autograd is on, progress is shown, and a cancelled prompt ends it."""

import importlib
import logging
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch.nn.modules.module import register_module_forward_pre_hook
from torch.optim.optimizer import register_optimizer_step_post_hook

from anystyle.io.sheet import to_pil
from anystyle.pipeline.stages import Stages
from anystyle.types import Progress

STEPS = 1000
"""Steps of a progress bar."""
PREVIEW = 512
"""Pixels of the longer side of a preview in a node."""

_log = logging.getLogger(__name__)


class Reporter:
    """Shows the progress of one node, and raises what ComfyUI raises once somebody cancels."""

    def __init__(self) -> None:
        self._bar = importlib.import_module("comfy.utils").ProgressBar(STEPS)
        self._management = importlib.import_module("comfy.model_management")
        self.stages = Stages(self._stage)

    def __call__(self, progress: Progress) -> None:
        """Report progress."""
        self.check()
        if progress.done is not None:
            preview = None if progress.thumbnail is None else ("JPEG", to_pil(progress.thumbnail), PREVIEW)
            self._bar.update_absolute(round(progress.done * STEPS), STEPS, preview)

    def check(self, *_: object) -> None:
        """End the work if somebody cancelled it."""
        self._management.throw_exception_if_processing_interrupted()

    def _stage(self, stage: str, progress: Progress) -> None:
        _log.info("%s %s", stage, progress.line)
        self(progress)


@contextmanager
def running() -> Iterator[Reporter]:
    """Leave the inference mode that ComfyUI runs nodes in, for a scene is fitted by gradients.

    Progress comes every few seconds. A cancelled prompt ends at the next step of an optimiser or call of a network.
    """
    report = Reporter()
    hooks = [register_optimizer_step_post_hook(report.check), register_module_forward_pre_hook(report.check)]
    try:
        with torch.inference_mode(False), torch.enable_grad():
            yield report
    finally:
        for hook in hooks:
            hook.remove()
