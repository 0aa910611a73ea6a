"""Arrays and tensors from files that nobody vouches for."""

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from anystyle.capacity import require
from anystyle.documents import regular
from anystyle.errors import UserError, one_line

MAX_BYTES = 1 << 30
"""What an array file may hold, unpacked."""


def read_array(path: Path, *, what: str = "array of numbers") -> NDArray[np.float64]:
    """A NPY file of finite real numbers, as double precision.

    Raises:
        UserError: It is none; the message names the file and ``what`` was expected.
    """
    regular(path, most=MAX_BYTES, what=what)
    try:
        # Mapped first: what the header announces and the file does not hold is never allocated.
        return _numbers(np.load(path, mmap_mode="r", allow_pickle=False))
    except MemoryError:
        raise
    except Exception as error:
        # Damaged headers make the parser raise nearly anything.
        raise UserError(f"{path} is no {what} ({_reason(error)})") from None


def read_arrays(path: Path, numbers: Sequence[str], names: Sequence[str] = (), *, what: str) -> dict[str, NDArray]:
    """Arrays of a NPZ file by name.

    Args:
        path: Of the file.
        numbers: Keys of arrays of finite real numbers, which come as double precision.
        names: Keys of arrays of text.
        what: What is expected, for messages.

    Raises:
        UserError: One is not there, or of another kind.
    """
    regular(path, most=MAX_BYTES, what=what)
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > MAX_BYTES:
                raise ValueError(f"more than {MAX_BYTES:,} bytes unpacked")
        with np.load(path, allow_pickle=False) as stored:
            values: dict[str, NDArray] = {name: _numbers(stored[name]) for name in numbers}
            values |= {name: np.array([str(item) for item in stored[name].ravel().tolist()]) for name in names}
        return values
    except MemoryError:
        raise
    except Exception as error:
        raise UserError(f"{path} is no {what} ({_reason(error)})") from None


def _numbers(values: NDArray) -> NDArray[np.float64]:
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise ValueError("it holds no real numbers")
    if not np.isfinite(values).all():
        raise ValueError("it holds numbers that are infinite or undefined")
    return np.array(values, np.float64)


def _reason(error: Exception) -> str:
    return one_line(error).strip("'\"")[:200] or type(error).__name__


def read_tensors(path: str | Path, *, what: str = "file of tensors", device: str | torch.device = "cpu") -> Any:
    """What ``torch.save`` wrote, if it is tensors and plain values.

    Raises:
        UserError: It is no such file, damaged, or holds objects; the message names it and ``what`` was expected.
    """
    path = regular(path, most=None, what=what)
    require(path.stat().st_size, str(path), "another machine has more")
    try:
        _check(path)
        return torch.load(path, map_location=device, weights_only=True)
    except MemoryError:
        raise
    except Exception as error:
        # Damaged archives and pickles raise nearly anything, the latter with a page of advice.
        reason = one_line(str(error).partition("\n")[0])[:200] or type(error).__name__
        if "Weights only load failed" in reason:
            reason = "it holds more than tensors and plain values"
        raise UserError(f"{path} is no {what}, or a damaged one ({reason})") from None


def _check(path: Path) -> None:
    # PyTorch writes checksums and does not compare them.
    with zipfile.ZipFile(path) as archive:
        torn = archive.testzip()
    if torn is not None:
        raise ValueError(f"{torn} in it is damaged")
