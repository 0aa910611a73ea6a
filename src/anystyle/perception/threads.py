"""Compiled kernels hold no lock of the interpreter: several threads can share what one is asked for."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import torch

Work = Callable[[int, int], object]
"""Does what is counted from the first number to before the second."""


@contextmanager
def workers() -> Iterator[Callable[[int, Work], None]]:
    """A function that lets as many threads as PyTorch has do so many pieces of work, each a range of them."""
    threads = torch.get_num_threads()
    with ThreadPoolExecutor(threads) as pool:

        def share(count: int, work: Work) -> None:
            each = -(-count // threads)
            if each == count:
                work(0, count)
                return
            jobs = [pool.submit(work, start, min(start + each, count)) for start in range(0, count, each)]
            for job in jobs:
                job.result()

        yield share
