"""COLMAP tells each of its steps on standard error; here it does not."""

from collections.abc import Iterator
from contextlib import contextmanager

import pycolmap


@contextmanager
def silent() -> Iterator[None]:
    """Let COLMAP say only what ends the process; also a decorator."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before
