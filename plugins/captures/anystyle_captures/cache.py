"""Results of captures cached in the user's cache folder between commands: cameras and fitted scenes."""

import hashlib
import logging
import os
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
from anystyle.paths import expanded

logger = logging.getLogger(__name__)
VARIABLE = "ANYSTYLE_CACHE"
"""The environment variable that names the folder; ``off`` disables the cache."""
LIMIT = 1 << 30
"""Bytes; the least recently used files are deleted first."""
FORMAT = "19"
"""To be changed whenever the same photographs and options give another result, which invalidates old entries."""


def folder() -> Path | None:
    """The cache folder, unless it is disabled."""
    name = os.environ.get(VARIABLE)
    if name == "off":
        return None
    if name:
        return expanded(name) / "scenes"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "anystyle" / "scenes"


def key_of(*parts: Any) -> str:
    """A hash of tensors and arrays by content, dtype and shape, and of everything else by its ``repr``."""
    digest = hashlib.sha256(FORMAT.encode())
    for part in parts:
        values = part.detach().cpu().numpy() if isinstance(part, Tensor) else part
        if isinstance(values, np.ndarray):
            digest.update(f"{values.shape}{values.dtype}".encode())
            digest.update(np.ascontiguousarray(values).data)
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()[:32]


def cached(kind: str, key: str | None, compute: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any], bool]:
    """Read a result from the cache, or compute and store it.

    Commands may share the folder. A damaged file is computed again; a failure to write is logged.
    """
    where = folder()
    if where is None or key is None:
        return compute(), False
    path = where / f"{kind}-{key}.pt"
    if path.is_file():
        try:
            value = read_tensors(path, what="cached result")
            path.touch()
        except (UserError, OSError) as error:
            logger.warning("%s; it is computed again", error)
        else:
            return value, True
    value = compute()
    try:
        with atomic_path(path) as temporary:
            torch.save(value, temporary)
        _delete_oldest(where)
    except OSError as error:
        logger.warning("nothing is cached in %s: %s", where, error.strerror or error)
    return value, False


def _delete_oldest(where: Path) -> None:
    """Delete the least recently used files until the rest is within the limit."""
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
