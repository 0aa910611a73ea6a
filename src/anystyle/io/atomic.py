"""Writing files so that nothing half-written ever stays under its final name."""

import json
import logging
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from filelock import SoftFileLease, Timeout

from anystyle.errors import UserError
from anystyle.io.documents import kept_json, plain

_log = logging.getLogger(__name__)
MADE = ".anystyle"
"""The file in which a folder of results lists the entries that this program made there."""
LOCK = ".lock"
PARTIAL = ".partial-"
"""The beginning of temporary names; only a killed process leaves such files, until the next one locks their folder."""
LEASE = 60.0
"""Seconds without a sign of life after which a lock is taken over, whatever machine its process was on."""


@contextmanager
def atomic_path(target: str | Path, *, sync: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``target``, of the same suffix, that is renamed to it when the block succeeds.

    A failing block leaves nothing. With ``sync`` the content is flushed to the disk before the file is renamed.
    """
    target = Path(target)
    if target.is_dir():
        raise UserError(f"{target} is a folder; name a file")
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


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file as :func:`atomic_path` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | Path, text: str, *, sync: bool = False) -> None:
    """Write a text as UTF-8, as :func:`atomic_path` does; what UTF-8 lacks, such as parts of file names, is escaped."""
    with atomic_path(path, sync=sync) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def write_json(path: str | Path, value: object) -> None:
    """Write a value as readable JSON; infinite and missing ones as :func:`~anystyle.io.documents.stored_number`."""
    write_text(path, json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n", sync=True)


@contextmanager
def atomic_directory(target: str | Path, expected: Collection[str] = (), *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary directory whose files move into ``target`` when the block succeeds.

    Entries of the same names from an earlier call are replaced, and with ``overwrite`` all of them; others stay, and a
    warning names them. What this program did not make stays in either case. A failing block leaves nothing. A UserError
    is raised where ``target`` is a file, or holds an entry of that name which this program did not make; for the
    ``expected`` names before the block begins.
    """
    target = Path(target)
    with _made_folder(target):
        made = kept_json(target / MADE, list[str]) or ()
        earlier = frozenset(name for name in made if os.path.lexists(target / name))
        _refuse_foreign(target, expected, earlier)
        temporary = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=target))
        try:
            yield temporary
            content = {path.relative_to(temporary).as_posix(): path for path in sorted(temporary.rglob("*"))}
            files = {name: path for name, path in content.items() if not path.is_dir()}
            _refuse_foreign(target, [*files, *(path.name for path in temporary.iterdir())], earlier)
            for path in files.values():
                _sync(path)
            write_json(target / MADE, sorted({*earlier, *files}))
            tops = {_top(name) for name in files}
            stale = {name for name in earlier.difference(files) if overwrite or _top(name) in tops}
            _delete(target, stale)
            for name, path in content.items():
                if name in files:
                    path.replace(target / name)
                else:
                    (target / name).mkdir(exist_ok=True)
            if left := sorted({_top(name) for name in earlier.difference(files, stale)}):
                _log.warning("%s also holds %s of an earlier run", target, ", ".join(left))
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def final(path: Path) -> Path:
    """Where a file will be that is written into a folder of :func:`atomic_directory`: to tell of it."""
    return Path(*(part for part in path.parts if not part.startswith(PARTIAL)))


@contextmanager
def folder_lock(folder: Path, refusal: str) -> Iterator[Callable[[], None]]:
    """Lock a folder until the block ends; a UserError with the message ``refusal`` if another process holds it.

    The lock is the file ``.lock``, which needs nothing of a file system but that it creates a file once. Its process
    touches it three times within :data:`LEASE` seconds. The lock of a process that has died on this machine is taken
    over, and so is one that was not touched for longer, as of a machine that has gone. What a killed process had begun
    to write there is deleted. The block is given a function that raises the same error if its own lock was taken over.
    """
    with _made_folder(folder):
        lease = SoftFileLease(folder / LOCK, lease_duration=LEASE, blocking=False)

        def busy() -> UserError:
            owner = lease.owner
            holder = (
                "another process" if owner is None else f"process {owner.pid} on {owner.hostname.partition('?')[0]}"
            )
            return UserError(f"{refusal} ({holder})")

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
            for left in folder.glob(f"{PARTIAL}*"):
                shutil.rmtree(left) if left.is_dir() else left.unlink(missing_ok=True)
            yield check
        finally:
            lease.release()


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
    if folder.exists() and not folder.is_dir():
        raise UserError(f"{folder} is a file; results need a directory")
    created = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):
            for path in created:
                path.rmdir()


def _refuse_foreign(target: Path, names: Collection[str], earlier: Collection[str]) -> None:
    known = {part for name in earlier for part in _parts(name)}
    for name in names:
        # Once the list had the names of folders and not of the files in them.
        if name not in known and _parts(name).isdisjoint(earlier) and os.path.lexists(target / name):
            raise UserError(f"{target / name} is there already and was not made by anystyle; choose another --out")


def _delete(target: Path, names: Collection[str]) -> None:
    """Delete files, and the folders that are empty then."""
    for path in (target / name for name in names):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
    for folder in sorted({part for name in names for part in _parts(name)}, reverse=True):
        with suppress(OSError):
            (target / folder).rmdir()


def _parts(name: str) -> set[str]:
    """A path and the folders that it is in."""
    path = PurePosixPath(name)
    return {str(part) for part in (path, *path.parents)} - {"."}


def _top(name: str) -> str:
    return name.partition("/")[0]


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
