"""Writing files so that nothing half-written ever stays under its final name."""

import functools
import glob
import json
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
from filelock import FileLock, Timeout

from anystyle.documents import kept_json, plain

MADE = ".anystyle"
"""The file in which a folder of results lists the entries that this program made there."""


@contextmanager
def atomic_path(target: str | Path, *, sync: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``target`` that takes its name when the block ends well.

    The suffix is kept, so that writers that choose a format by it work; a failing block leaves nothing behind. What
    killed processes left in the folder is swept at this process's first write there.

    Args:
        target: The file.
        sync: Whether it is on the disk, rather than on its way there, before it takes its name.
    """
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    _sweep_files(target.parent.absolute())
    handle, name = tempfile.mkstemp(prefix=_own(f".{target.stem[:40]}-"), suffix=target.suffix, dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes private files; a result is as readable as any other new file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        if sync:
            _sync(temporary)
        temporary.replace(target)
        if sync and os.name == "posix":
            _sync(target.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def write_json(path: str | Path, value: object) -> None:
    """Write a value as readable JSON, see :func:`anystyle.documents.plain`; whole or not at all, and on the disk."""
    with atomic_path(path, sync=True) as temporary:
        temporary.write_text(
            json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
        )


@contextmanager
def atomic_directory(target: str | Path, expected: Collection[str] = ()) -> Iterator[Path]:
    """Yield a temporary directory whose entries move into ``target`` when the block ends well.

    Entries of the same names that an earlier call made are replaced whole, others in ``target`` stay; a failing block
    leaves nothing behind, and what a killed process left is swept.

    Args:
        target: The directory.
        expected: Names of entries that are going to be made, so that a clash is found before the block begins.

    Raises:
        ValueError: ``target`` is a file, or holds an entry of the same name that this program did not make.
        OSError: ``target`` cannot be written; found out before the block begins.
    """
    target = Path(target)
    if target.exists() and not target.is_dir():
        raise ValueError(f"{target} is a file; results need a directory")
    created = [folder for folder in (target, *target.parents) if not folder.exists()]
    target.mkdir(parents=True, exist_ok=True)
    earlier = frozenset(kept_json(target / MADE, list[str]) or ())
    _refuse(target, expected, earlier)
    _sweep(target)
    temporary = Path(tempfile.mkdtemp(prefix=_own(_PARTIAL), dir=target))
    finished = False
    try:
        yield temporary
        entries = sorted(temporary.iterdir())
        names = [entry.name for entry in entries]
        _refuse(target, names, earlier)
        for path in temporary.rglob("*"):
            if path.is_file():
                _sync(path)
        write_json(target / MADE, sorted({*earlier, *names}))
        with tempfile.TemporaryDirectory(prefix=_own(_REPLACED), dir=target) as replaced:
            for entry in entries:
                destination = target / entry.name
                if destination.is_dir() and not destination.is_symlink():
                    destination.rename(Path(replaced) / entry.name)  # deleting a folder takes time, renaming none
                entry.replace(destination)
        finished = True
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for folder in [] if finished else created:
            with suppress(OSError):
                folder.rmdir()


_PARTIAL, _REPLACED = ".partial-", ".replaced-"


def _refuse(target: Path, names: Collection[str], earlier: Collection[str]) -> None:
    """Refuse to replace what was not made here."""
    clash = next((name for name in names if name not in earlier and os.path.lexists(target / name)), None)
    if clash is not None:
        raise ValueError(f"{target / clash} is there already and was not made by anystyle; choose another --out")


def _own(prefix: str) -> str:
    """The beginning of temporary names that tells whose they are; machines may share a disk."""
    return f"{prefix}{platform.node()}-{os.getpid()}-"


@functools.lru_cache(maxsize=256)
def _sweep_files(folder: Path) -> None:
    """Remove the temporary files of processes that are no more; again does nothing, as a folder may have many files."""
    left = re.compile(rf"\..{{1,40}}-{re.escape(platform.node())}-(\d+)-\w{{8}}(\.\w*)?")
    for path in folder.iterdir():
        match = left.fullmatch(path.name)
        if match is not None and not psutil.pid_exists(int(match[1])) and path.is_file():
            path.unlink(missing_ok=True)


def _left(folder: Path, prefix: str) -> list[Path]:
    """What processes of this machine left that are no more."""
    known = f"{prefix}{platform.node()}-"
    numbers = {path: path.name[len(known) :].partition("-")[0] for path in folder.glob(f"{glob.escape(known)}*")}
    return [path for path, number in numbers.items() if number.isdecimal() and not psutil.pid_exists(int(number))]


def _sweep(target: Path) -> None:
    """Remove what processes left that are no more; a folder that was about to be replaced is put back."""
    for replaced in _left(target, _REPLACED):
        for entry in replaced.iterdir():
            if not os.path.lexists(target / entry.name):
                entry.rename(target / entry.name)
    for left in (*_left(target, _REPLACED), *_left(target, _PARTIAL)):
        shutil.rmtree(left, ignore_errors=True)


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
