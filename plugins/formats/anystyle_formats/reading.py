"""What readers share: a file that is damaged, or none of the format, ends in one line."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Shaped
from numpy.typing import NDArray

from anystyle.errors import UserError, one_line
from anystyle.geometry.transforms import Similarity
from anystyle.io.documents import regular
from anystyle.io.limits import require
from anystyle.types import Gaussians

BYTES = 480
"""Memory that a Gaussian of degree 3 takes while it is decoded: two copies of its 59 numbers."""


@contextmanager
def reading(path: Path, what: str) -> Iterator[Path]:
    """Check that a path is a file; errors of parsers become a UserError that names it."""
    regular(path, most=None, what=what)
    require(4 * path.stat().st_size, str(path), "a scene of fewer Gaussians, or another machine")
    try:
        yield path
    except (UserError, ImportError, MemoryError):
        raise
    except Exception as error:  # parsers of damaged files raise nearly anything
        reason = type(error).__name__
        with suppress(UnicodeError):  # libraries in C++ quote bytes of the file
            reason = one_line(error)[:200] or reason
        raise UserError(f"{path} is no {what} that can be read ({reason})") from None


def room_for(path: Path, count: int) -> int:
    """A number of Gaussians that a header claims, once memory for them is there."""
    if count < 1:
        raise ValueError("it has no Gaussians")
    require(BYTES * count, f"{path}, {count:,} Gaussians", "a scene of fewer, or another machine")
    return count


def gaussians(
    means: Shaped[np.ndarray, "N 3"],
    wxyz: Shaped[np.ndarray, "N 4"],
    scales: Shaped[np.ndarray, "N 3"],
    opacities: Shaped[np.ndarray, " N"],
    harmonics: Shaped[np.ndarray, "N K 3"],
) -> Gaussians:
    """A batch of one scene in float32; ValueError where numbers are infinite, none, or out of range."""
    columns = (means, wxyz, scales, opacities, harmonics)
    tensors = [torch.from_numpy(np.array(column, np.float32))[None] for column in columns]
    if not len(means) or not all(bool(tensor.isfinite().all()) for tensor in tensors):
        raise ValueError("Gaussians are missing, or have properties that are infinite or no numbers")
    if bool((tensors[2] < 0).any()):
        raise ValueError("Gaussians have negative scales")
    tensors[3] = tensors[3].clamp(0, 1)
    return Gaussians(*tensors)


def moved(part: Gaussians, world: NDArray[np.float64]) -> Gaussians:
    """Gaussians under a transformation that turns, moves and scales evenly."""
    if np.array_equal(world, np.eye(4)):
        return part
    scale = np.cbrt(np.linalg.det(world[:3, :3]))
    turn = world[:3, :3] / scale if scale > 0 else np.zeros((3, 3))
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3):
        raise ValueError("nodes that mirror, shear or scale unevenly are not read")
    columns = (torch.from_numpy(np.array(values, np.float32)) for values in (scale, turn, world[:3, 3]))
    return Similarity(*columns).gaussians(part)


def joined(parts: Iterable[Gaussians]) -> Gaussians:
    """Several scenes as one; colours of lower degrees get coefficients of 0."""
    found = list(parts)
    if not found:
        raise ValueError("it shows no Gaussians")
    most = max(part.harmonics.shape[2] for part in found)
    colors = [F.pad(part.harmonics, (0, 0, 0, most - part.harmonics.shape[2])) for part in found]
    padded = [replace(part, harmonics=color) for part, color in zip(found, colors, strict=True)]
    return Gaussians(**{name: torch.cat([vars(part)[name] for part in padded], 1) for name in vars(found[0])})
