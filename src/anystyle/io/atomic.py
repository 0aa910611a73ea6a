"""Writing files so that nothing half-written ever stays under its final name."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from anystyle.documents import plain


@contextmanager
def atomic_path(target: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside ``target`` that takes its name when the block ends well.

    The suffix is kept, so that writers that choose a format by it work; a failing block leaves nothing behind.
    """
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{target.stem[:40]}-", suffix=target.suffix, dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes private files; a result is as readable as any other new file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: str | Path, value: object) -> None:
    """Write a value as readable JSON, see :func:`anystyle.documents.plain`; whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(
            json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8"
        )


@contextmanager
def atomic_directory(target: str | Path) -> Iterator[Path]:
    """Yield a temporary directory whose entries move into ``target`` when the block ends well.

    Entries of the same names are replaced whole, others in ``target`` stay; a failing block leaves nothing behind.

    Raises:
        ValueError: ``target`` is a file.
        OSError: ``target`` cannot be written; found out before the block begins.
    """
    target = Path(target)
    if target.exists() and not target.is_dir():
        raise ValueError(f"{target} is a file; results need a directory")
    created = [folder for folder in (target, *target.parents) if not folder.exists()]
    target.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=".partial-", dir=target))
    finished = False
    try:
        yield temporary
        for entry in sorted(temporary.iterdir()):
            destination = target / entry.name
            if destination.is_dir() and not destination.is_symlink():
                shutil.rmtree(destination)
            entry.replace(destination)
        finished = True
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        for folder in [] if finished else created:
            with suppress(OSError):
                folder.rmdir()
