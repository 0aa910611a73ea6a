"""Steps of one view each that can be stopped and taken up again: what all optimisations of Gaussians have in common."""

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

from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import atomic_path

logger = logging.getLogger(__name__)


class Loop(ABC):
    """An optimisation over views, in an order drawn anew whenever all had their turn.

    Args:
        training: The views that steps see.
        every: Steps between two looks at where it is.
        seed: Of the order of views and all else that is random.
    """

    def __init__(self, training: list[int], *, every: int, seed: int) -> None:
        self.training, self.every = training, every
        self.generator = torch.Generator().manual_seed(seed)
        self.step = 0
        self.order: list[int] = []
        self.recent: list[float] = []

    @property
    @abstractmethod
    def last_step(self) -> int:
        """Where it ends, as far as is known."""

    @abstractmethod
    def advance(self) -> float:
        """Take one step and return what is averaged over the last views."""

    @abstractmethod
    def look(self) -> None:
        """Measure what is measured now and then."""

    def next_view(self) -> int:
        """The view of the next step."""
        if not self.order:
            self.order = [self.training[i] for i in torch.randperm(len(self.training), generator=self.generator)]
        return self.order.pop()

    @property
    def mean(self) -> float:
        """What :meth:`advance` returned, over the last views."""
        return sum(self.recent) / max(len(self.recent), 1)

    def steps(self, on_look: Callable[[float], None], on_checkpoint: Callable[[], None] | None = None) -> None:
        """Take all steps that are left.

        Args:
            on_look: Called every so often with the seconds that a step takes.
            on_checkpoint: Called where the state is worth being written: after it.
        """
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
        """Whether this step is looked at whatever its number."""
        return False

    def state_dict(self) -> dict[str, Any]:
        """All that the same work needs to go on; ``torch.save`` can write it."""
        return {
            "generator": self.generator.get_state(),
            "step": self.step,
            "training": self.training,
            "order": self.order,
            "recent": self.recent,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`state_dict` gave."""
        self.generator.set_state(state["generator"])
        self.training = list(state["training"])
        self.step, self.order, self.recent = state["step"], list(state["order"]), list(state["recent"])


def _keep_freed_memory() -> None:
    """Have the C library keep what a step frees for the next one, instead of giving it back to be cleared anew.

    glibc keeps as much as twice the largest block that it mapped and gave back, up to 32 MiB a block (mallopt(3),
    M_MMAP_THRESHOLD). A step on 30,000 Gaussians and 224 x 224 pixels costs a tenth less; elsewhere nothing changes.
    """
    torch.empty(31 << 20, dtype=torch.uint8)


def fingerprint(words: object, tensors: Mapping[str, Tensor]) -> str:
    """What a state must have been written for."""
    digest = hashlib.sha256(repr(words).encode())
    for tensor in tensors.values():
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def write_state(loop: Loop, path: Path, key: str) -> None:
    """Write where a loop is."""
    with atomic_path(path, sync=True) as temporary:
        torch.save({"key": key, "fit": loop.state_dict()}, temporary)


def resume(loop: Loop, path: Path, key: str, device: torch.device) -> None:
    """Take up a loop that was broken off; one of other photographs or options is begun anew, and its state kept.

    Raises:
        ValueError: The file is no state.
    """
    if not path.is_file():
        return
    what = "state of a fit; name another file as state, or delete it"
    written = read_tensors(path, what=what, device=device)
    if not isinstance(written, dict) or set(written) != {"key", "fit"}:
        raise ValueError(f"{path} is no state of a fit; name another file as state")
    if written["key"] != key:
        aside = next(name for number in count(1) if not (name := path.with_name(f"{path.name}.{number}")).exists())
        path.rename(aside)
        logger.warning(
            "%s was written for other photographs or options: it is %s now, and the fit begins anew", path, aside.name
        )
        return
    loop.load_state_dict(written["fit"])
    logger.info("the fit goes on at step %d of %d", loop.step, loop.last_step)
