"""One process at a time in a folder."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout


@contextmanager
def folder_lock(folder: Path, refusal: str) -> Iterator[None]:
    """Keep other processes out of a folder until the block ends, however it ends.

    Args:
        folder: Made where it is missing; the lock is its file ``.lock``, which stays unless nothing else was made.
        refusal: The message of the error.

    Raises:
        ValueError: Another process holds the folder.
    """
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / ".lock")
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise ValueError(refusal) from None
    try:
        yield
    finally:
        lock.release()
        if [entry.name for entry in folder.iterdir()] == [".lock"]:
            (folder / ".lock").unlink()  # nothing came of it
            for path in created:
                with suppress(OSError):
                    path.rmdir()
