"""Writing files so that nothing half-written ever stays under its final name."""

import json
import logging
import os
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from anystyle.errors import UserError
from anystyle.io.documents import kept_json, plain

_log = logging.getLogger(__name__)
MADE = ".anystyle"
"""The file in which a folder of results lists the entries that this program made there."""
PARTIAL = ".partial-"
"""The beginning of temporary names; only a killed process leaves such files."""


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
def folder_lock(folder: Path, refusal: str) -> Iterator[None]:
    """Lock a folder until the block ends, or raise a UserError of the message ``refusal`` if another process does.

    The lock is its file ``.lock``, which is deleted if nothing else was written.
    """
    with _made_folder(folder):
        lock = FileLock(folder / ".lock")
        try:
            lock.acquire(blocking=False)
        except Timeout:
            raise UserError(refusal) from None
        try:
            yield
        finally:
            lock.release()
            if [entry.name for entry in folder.iterdir()] == [".lock"]:
                (folder / ".lock").unlink()


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
