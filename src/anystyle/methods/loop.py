"""The loop that all optimisations of Gaussians share: steps of one view each, which can be interrupted and resumed."""

import hashlib
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anystyle.errors import UserError
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import atomic_path

logger = logging.getLogger(__name__)


class Loop(ABC):
    """An optimisation over views, which are shuffled again after every pass, with an evaluation ``every`` few steps."""

    def __init__(self, training: list[int], *, every: int, seed: int) -> None:
        self.training, self.every = training, every
        self.generator = torch.Generator().manual_seed(seed)
        self.step = 0
        self.order: list[int] = []
        self.recent: list[float] = []

    @property
    @abstractmethod
    def last_step(self) -> int:
        """The step at which it ends, as currently planned."""

    @abstractmethod
    def advance(self) -> float:
        """Take one step and return the value that :attr:`mean` averages."""

    @abstractmethod
    def look(self) -> None:
        """Evaluate the current state; called every ``every`` steps."""

    def next_view(self) -> int:
        """The view of the next step."""
        if not self.order:
            self.order = [self.training[i] for i in torch.randperm(len(self.training), generator=self.generator)]
        return self.order.pop()

    @property
    def mean(self) -> float:
        """The mean of what :meth:`advance` returned in the last pass over the views."""
        return sum(self.recent) / max(len(self.recent), 1)

    def steps(self, on_look: Callable[[float], None], on_checkpoint: Callable[[], None] | None = None) -> None:
        """Take all remaining steps; ``on_look`` is called after every evaluation with the seconds a step takes."""
        _keep_freed_memory()
        started, first = time.monotonic(), self.step
        while self.step < self.last_step:
            self.recent = [*self.recent[1 - len(self.training) :], self.advance()]
            if self.step % self.every and self.step != self.last_step and not self.at_turn():
                continue
            self.look()
            on_look((time.monotonic() - started) / (self.step - first))
            if on_checkpoint is not None:
                on_checkpoint()

    def at_turn(self) -> bool:
        """Whether to evaluate at this step whatever its number."""
        return False

    def state_dict(self) -> dict[str, Any]:
        """All that is needed to resume; ``torch.save`` can write it."""
        return {
            "generator": self.generator.get_state(),
            "step": self.step,
            "training": self.training,
            "order": self.order,
            "recent": self.recent,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.generator.set_state(state["generator"])
        self.training = list(state["training"])
        self.step, self.order, self.recent = state["step"], list(state["order"]), list(state["recent"])


def _keep_freed_memory() -> None:
    """Have the C library reuse the memory that a step frees, instead of returning it to the system.

    glibc keeps up to twice the largest block that it mapped and freed, at most 32 MiB a block (mallopt(3),
    M_MMAP_THRESHOLD). A step on 30,000 Gaussians and 224 x 224 pixels is a tenth faster.
    """
    torch.empty(31 << 20, dtype=torch.uint8)


def fingerprint(words: object, tensors: Mapping[str, Tensor]) -> str:
    """A hash of the inputs and options that a state belongs to."""
    digest = hashlib.sha256(repr(words).encode())
    for tensor in tensors.values():
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def write_state(loop: Loop, path: Path, key: str) -> None:
    """Write the state of a loop."""
    with atomic_path(path, sync=True) as temporary:
        torch.save({"key": key, "fit": loop.state_dict()}, temporary)


def resume(loop: Loop, path: Path, key: str, device: torch.device) -> None:
    """Resume an interrupted loop. A state of other photographs or options is renamed, and the loop starts afresh."""
    if not path.is_file():
        return
    what = "state of a fit; name another file as state, or delete it"
    written = read_tensors(path, what=what, device=device)
    if not isinstance(written, dict) or set(written) != {"key", "fit"}:
        raise UserError(f"{path} is no state of a fit; name another file as state")
    if written["key"] != key:
        aside = next(name for number in count(1) if not (name := path.with_name(f"{path.name}.{number}")).exists())
        path.rename(aside)
        logger.warning(
            "%s was written for other photographs or options: it is %s now, and the fit begins anew", path, aside.name
        )
        return
    loop.load_state_dict(written["fit"])
    logger.info("the fit goes on at step %d of %d", loop.step, loop.last_step)
