"""What was computed of photographs, kept in the user's cache folder between commands: cameras and fitted scenes."""

import hashlib
import logging
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from anystyle.errors import UserError
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import atomic_path

logger = logging.getLogger(__name__)

VARIABLE = "ANYSTYLE_CACHE"
"""The environment variable that names the folder; ``off`` keeps nothing."""

LIMIT = 1 << 30
"""Bytes that are kept; what was used least recently goes first."""

FORMAT = "3"
"""Changes whenever the same photographs and options come to something else, so that nothing old is taken for it."""


def folder() -> Path | None:
    """Where results are kept, if they are."""
    named = os.environ.get(VARIABLE)
    if named == "off":
        return None
    if named:
        return Path(named).expanduser() / "scenes"
    home = Path.home()
    system = {"darwin": home / "Library" / "Caches", "win32": Path(os.environ.get("LOCALAPPDATA") or home / ".cache")}
    base = system.get(sys.platform) or Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return base / "anystyle" / "scenes"


def key_of(*parts: Any) -> str:
    """A hash of tensors and arrays by content and shape, and of all else by what ``repr`` says of it."""
    digest = hashlib.sha256(FORMAT.encode())
    for part in parts:
        values = part.detach().cpu().numpy() if isinstance(part, Tensor) else part
        if isinstance(values, np.ndarray):
            digest.update(f"{values.shape}{values.dtype}".encode())
            digest.update(np.ascontiguousarray(values).data)
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()[:32]


def kept(kind: str, key: str, compute: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any], bool]:
    """What was computed before under a key, or is now.

    Commands may share the folder: a file has its name only when it is whole. One that cannot be read is computed anew,
    and where nothing can be written nothing is kept.

    Args:
        kind: What it is, the beginning of the file's name.
        key: Of all that it depends on; see :func:`key_of`.
        compute: Returns tensors and plain values.

    Returns:
        It, and whether it was kept from before.
    """
    where = folder()
    if where is None:
        return compute(), False
    path = where / f"{kind}-{key}.pt"
    if path.is_file():
        try:
            value = read_tensors(path, what="kept result")
            path.touch()
        except (UserError, OSError) as error:
            logger.warning("%s; it is computed anew", error)
        else:
            return value, True
    value = compute()
    try:
        with atomic_path(path) as temporary:
            torch.save(value, temporary)
        _forget(where)
    except OSError as error:
        logger.warning("nothing is kept in %s: %s", where, error.strerror or error)
    return value, False


def _forget(where: Path) -> None:
    """Remove the files that were used least recently until the rest is within the limit."""
    files = []
    for path in where.glob("*.pt"):
        with suppress(OSError):  # another command may have removed it
            files.append((path.stat().st_mtime_ns, path.stat().st_size, path))
    total = sum(size for _, size, _ in files)
    for _, size, path in sorted(files):
        if total <= LIMIT:
            break
        with suppress(OSError):
            path.unlink()
        total -= size
