"""Writing files so that nothing half-written ever stays under its final name."""

import json
import logging
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import SoftFileLease, Timeout

from anystyle.errors import UserError
from anystyle.io.documents import kept_json, plain

_log = logging.getLogger(__name__)
MADE = ".anystyle"
"""The file in which a folder of results lists the entries that this program made there."""
LOCK = ".lock"
PARTIAL = ".partial-"
"""The beginning of temporary names; only a killed process leaves such files."""
LEASE = 60.0
"""Seconds without a sign of life after which a lock is taken over, whatever machine its process was on."""


class Busy(UserError):
    """Another process is at work in a folder.

    Args:
        message: The line for the user.
        folder: The folder.
        holder: Which process, in words.
    """

    def __init__(self, message: str, folder: Path = Path(), holder: str = "another process") -> None:
        super().__init__(message)
        self.folder, self.holder = folder, holder


@contextmanager
def atomic_path(target: str | Path, *, sync: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``target``, of the same suffix, that is renamed to it when the block succeeds.

    A failing block leaves nothing. With ``sync`` the content is flushed to the disk before the file is renamed.
    """
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=PARTIAL, suffix=target.suffix, dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)  # mkstemp makes private files; results get the usual permissions
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        if sync:
            _sync(temporary)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: str | Path, value: object) -> None:
    """Write a value as readable JSON; numbers that are not finite as :func:`anystyle.io.documents.as_figure` does."""
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    with atomic_path(path, sync=True) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


@contextmanager
def atomic_directory(target: str | Path, expected: Collection[str] = ()) -> Iterator[Path]:
    """Yield a temporary directory whose entries move into ``target`` when the block succeeds.

    Entries of the same names from an earlier call are replaced, others stay, and a warning names them; a failing block
    leaves nothing. A UserError is raised where ``target`` is a file, or holds an entry of that name which this program
    did not make; for the ``expected`` names before the block begins.
    """
    target = Path(target)
    if target.exists() and not target.is_dir():
        raise UserError(f"{target} is a file; results need a directory")
    with _made_folder(target):
        earlier = frozenset(kept_json(target / MADE, list[str]) or ())
        _refuse_foreign(target, expected, earlier)
        temporary = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=target))
        try:
            yield temporary
            names = sorted(entry.name for entry in temporary.iterdir())
            _refuse_foreign(target, names, earlier)
            for path in temporary.rglob("*"):
                if path.is_file():
                    _sync(path)
            write_json(target / MADE, sorted({*earlier, *names}))
            for name in names:
                if (target / name).is_dir() and not (target / name).is_symlink():
                    shutil.rmtree(target / name)
                (temporary / name).replace(target / name)
            if left := sorted(name for name in earlier.difference(names) if (target / name).exists()):
                _log.warning("%s also holds %s of an earlier run", target, ", ".join(left))
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def folder_lock(folder: Path, refusal: str) -> Iterator[Callable[[], None]]:
    """Lock a folder until the block ends, or raise :class:`Busy` of the message ``refusal`` if another process does.

    The lock is the file ``.lock``, which needs nothing of a file system but that it creates a file once. Its process
    touches it three times within :data:`LEASE` seconds. The lock of a process that has died on this machine is taken
    over, and so is one that was not touched for longer, as of a machine that has gone. The block is given a function
    that raises ``Busy`` if that happened to its own.
    """
    with _made_folder(folder):
        lease = SoftFileLease(folder / LOCK, lease_duration=LEASE, blocking=False)

        def busy() -> Busy:
            owner = lease.owner
            holder = (
                "another process" if owner is None else f"process {owner.pid} on {owner.hostname.partition('?')[0]}"
            )
            return Busy(f"{refusal} ({holder})", folder, holder)

        def check() -> None:
            if not lease.is_lock_held_by_us:
                raise busy()

        while not lease.is_locked:
            try:
                lease.acquire()
            except Timeout:
                # Where a file system cannot exchange two names, as NFS, the library leaves every lock as it is.
                if (silent := _silence(folder)) <= LEASE:
                    raise busy() from None
                if silent < math.inf:
                    lease.force_break()
        try:
            yield check
        finally:
            lease.release()


def is_locked(folder: Path) -> bool:
    """Whether a process is at work in a folder: its lock is there, and was touched within :data:`LEASE` seconds."""
    return _silence(folder) <= LEASE


def _silence(folder: Path) -> float:
    """Seconds since a folder's lock was touched, by the clock of the disk that it is on; infinite without a lock."""
    with (
        suppress(FileNotFoundError),
        (folder / LOCK).open("rb") as lock,  # a network file system may keep what it knows of one that is not opened
        tempfile.TemporaryFile(prefix=PARTIAL, dir=folder) as now,
    ):
        return os.fstat(now.fileno()).st_mtime - os.fstat(lock.fileno()).st_mtime
    return math.inf


@contextmanager
def _made_folder(folder: Path) -> Iterator[None]:
    """Create a folder and its parents; those that are empty at the end are deleted again."""
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):
            for path in created:
                path.rmdir()


def _refuse_foreign(target: Path, names: Collection[str], earlier: Collection[str]) -> None:
    for name in names:
        if name not in earlier and os.path.lexists(target / name):
            raise UserError(f"{target / name} is there already and was not made by anystyle; choose another --out")


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
