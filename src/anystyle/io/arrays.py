"""Arrays and tensors from untrusted files."""

import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils._pytree import tree_leaves

from anystyle.io.documents import parsing, regular
from anystyle.io.limits import require

MAX_BYTES = 1 << 30
"""The largest array file that is read, unpacked."""


def read_array(path: Path, *, what: str = "array of numbers") -> NDArray[np.float64]:
    """Read a NPY file of finite real numbers, as double precision."""
    regular(path, most=MAX_BYTES, what=what)
    with parsing(path, what):
        # Mapped first: a header that announces more than the file holds allocates nothing.
        return _numbers(np.load(path, mmap_mode="r", allow_pickle=False))


def read_arrays(path: Path, numbers: Sequence[str], names: Sequence[str] = (), *, what: str) -> dict[str, NDArray]:
    """Read arrays of finite real numbers, in double precision, and arrays of text of a NPZ file by their keys."""
    regular(path, most=MAX_BYTES, what=what)
    with parsing(path, what):
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > MAX_BYTES:
                raise ValueError(f"more than {MAX_BYTES:,} bytes unpacked")
        with np.load(path, allow_pickle=False) as stored:
            values: dict[str, NDArray] = {name: _numbers(stored[name]) for name in numbers}
            return values | {name: np.array([str(item) for item in stored[name].ravel().tolist()]) for name in names}


def check_tensors(tensors: Iterable[Tensor]) -> None:
    """Refuse tensors that announce more numbers than the file holds: sparse ones, without data, or stretched."""
    for tensor in tensors:
        shape = f"a tensor of shape {list(tensor.shape)}"
        if tensor.layout != torch.strided or tensor.is_meta or tensor.is_quantized:
            raise ValueError(f"{shape} is sparse, quantized or without data; save dense ones")
        if tensor.numel() * tensor.itemsize > max(tensor.untyped_storage().nbytes(), 1 << 26):
            raise ValueError(f"{shape} repeats the {tensor.untyped_storage().nbytes():,} bytes it is stored in")


def read_tensors(path: str | Path, *, what: str = "file of tensors", device: str | torch.device = "cpu") -> Any:
    """Read what ``torch.save`` wrote, if it holds tensors and plain values only."""
    path = regular(path, most=None, what=what)
    require(path.stat().st_size, str(path), "another machine has more")
    with parsing(path, what):
        with zipfile.ZipFile(path) as archive:  # PyTorch writes checksums and does not compare them
            if (damaged := archive.testzip()) is not None:
                raise ValueError(f"{damaged} in it is damaged")
        values = torch.load(path, map_location=device, weights_only=True)
        check_tensors(value for value in tree_leaves(values) if isinstance(value, Tensor))
        return values


def _numbers(values: NDArray) -> NDArray[np.float64]:
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise ValueError("it holds no real numbers")
    if not np.isfinite(values).all():
        raise ValueError("it holds numbers that are infinite or undefined")
    return np.array(values, np.float64)
