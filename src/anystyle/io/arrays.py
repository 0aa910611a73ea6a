"""NPY and NPZ files, read without trusting them."""

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
