"""PyTorch files of tensors and plain values: nothing in them is executed, and damage is noticed."""

import zipfile
from pathlib import Path
from typing import Any

import torch

from anystyle.capacity import require
from anystyle.documents import regular
from anystyle.errors import UserError, one_line


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
