"""Random numbers that are the same in every run, and leave the caller's as they were."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Draw from torch's global generators as after ``seed``, and leave them as they were."""
    before = torch.initial_seed()
    devices = range(torch.cuda.device_count()) if torch.cuda.is_initialized() else ()
    try:
        with torch.random.fork_rng(devices=devices):
            torch.manual_seed(seed)
            yield
    finally:
        if not devices and torch.cuda.is_initialized():  # in the block, with the block's seed
            torch.cuda.manual_seed_all(before)
