"""What readers share: a file that is damaged, or not of the format, ends in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Shaped

from anystyle.io.documents import parsing, regular
from anystyle.io.limits import require
from anystyle.io.splats import Remarks, Splats, visible
from anystyle.types import Gaussians

BYTES = 480
"""Memory that a Gaussian of degree 3 takes while it is decoded: two copies of its 59 numbers."""


@contextmanager
def reading(path: Path, what: str) -> Iterator[Remarks]:
    """Check that a path is a file, and tell what was remarked of it; errors of parsers become a UserError."""
    regular(path, most=None, what=what)
    require(4 * path.stat().st_size, str(path), "a scene of fewer Gaussians, or another machine")
    remarks = Remarks(path)
    with parsing(path, what), np.errstate(all="ignore"):  # infinite numbers and NaN are looked for
        yield remarks
    remarks.tell()


def room_for(path: Path, count: int) -> int:
    """A number of Gaussians that a header claims, once memory for them is there."""
    if count < 1:
        raise ValueError("it has no Gaussians")
    require(BYTES * count, f"{path}, {count:,} Gaussians", "a scene of fewer, or another machine")
    return count


def gaussians(
    remarks: Remarks,
    means: Shaped[np.ndarray, "N 3"],
    wxyz: Shaped[np.ndarray, "N 4"],
    scales: Shaped[np.ndarray, "N 3"],
    opacities: Shaped[np.ndarray, " N"],
    harmonics: Shaped[np.ndarray, "N K 3"],
) -> Gaussians:
    """A batch of one scene in float32, without Gaussians that show nothing."""
    columns = (means, wxyz, scales, opacities, harmonics)
    rows = Splats(*(torch.from_numpy(np.array(column, np.float32)) for column in columns))
    return Gaussians(*(column[None] for column in visible(rows, remarks)[0]))
