"""One process at a time in a folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout


@contextmanager
def folder_lock(folder: Path, refusal: str) -> Iterator[None]:
    """Keep other processes out of a folder until the block ends, however it ends.

    Args:
        folder: Exists; the lock is its file ``.lock``, which stays.
        refusal: The message of the error.

    Raises:
        ValueError: Another process holds the folder.
    """
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise ValueError(refusal) from None
    try:
        yield
    finally:
        lock.release()
