"""COLMAP tells each of its steps on standard error; here it does not."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pycolmap

if threading.current_thread() is threading.main_thread():
    # Its import lets signals print a native stack; Python's own handlers are put back.
    for _number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(_number, signal.getsignal(_number) or signal.SIG_DFL)


@contextmanager
def silent() -> Iterator[None]:
    """Let COLMAP say only what ends the process; also a decorator."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before
