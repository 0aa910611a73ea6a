"""What readers share: a file that is damaged, or not of the format, ends in one line."""

from collections.abc import Iterator, Sequence
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
from anystyle.io.splats import Offset, Remarks, Splats, offset_of, visible
from anystyle.types import Cameras, Gaussians, StyledScene

BYTES = 480
"""Memory that a Gaussian of degree 3 takes while it is decoded: two copies of its 59 numbers."""


@contextmanager
def reading(path: Path, what: str) -> Iterator[Remarks]:
    """Check that a path is a file, and tell what was remarked of it; errors of parsers become a UserError."""
    regular(path, most=None, what=what)
    require(4 * path.stat().st_size, str(path), "a scene of fewer Gaussians, or another machine")
    remarks = Remarks(path)
    try:
        with np.errstate(all="ignore"):  # infinite numbers and NaN are looked for
            yield remarks
    except (UserError, ImportError, MemoryError):
        raise
    except Exception as error:  # parsers of damaged files raise nearly anything
        reason = type(error).__name__
        with suppress(UnicodeError):  # libraries in C++ quote bytes of the file
            reason = f"it lacks {error}" if isinstance(error, KeyError) else one_line(error)[:200] or reason
        raise UserError(f"{path} is not a readable {what} ({reason})") from None
    remarks.tell()


def cameras_of_one_size(
    views: Sequence[tuple[tuple[int, int], str, NDArray[np.float64], NDArray[np.float64]]],
) -> tuple[Cameras, tuple[str, ...]]:
    """The cameras of sizes, names, poses and intrinsics, those of the first one's size, and their names."""
    if not views:
        return StyledScene(()).cameras, ()
    _, names, *columns = zip(*(view for view in views if view[0] == views[0][0]), strict=True)
    poses, intrinsics = (torch.from_numpy(np.array(rows)).float()[None] for rows in columns)
    return Cameras(poses, intrinsics, views[0][0]), names


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


Placed = tuple[Gaussians, NDArray[np.float64]]
"""Gaussians, and the transformation from their coordinates to the world's."""


def joined(parts: Sequence[Placed], offset: Offset) -> Gaussians:
    """Parts where they are placed, without an offset, as one; colours of lower degrees get coefficients of 0."""
    scenes = [_moved(part, world, offset) for part, world in parts]
    most = max(part.harmonics.shape[2] for part in scenes)
    colors = [F.pad(part.harmonics, (0, 0, 0, most - part.harmonics.shape[2])) for part in scenes]
    padded = [replace(part, harmonics=color) for part, color in zip(scenes, colors, strict=True)]
    return Gaussians(**{name: torch.cat([vars(part)[name] for part in padded], 1) for name in vars(padded[0])})


def offset_of_parts(found: Sequence[Placed], remarks: Remarks) -> Offset:
    """What is to be taken off the positions of parts that are placed far away."""
    if not found:
        raise ValueError("it shows no Gaussians")
    return offset_of(np.array([world[:3, 3] for _, world in found]), remarks)


def _moved(part: Gaussians, world: NDArray[np.float64], offset: Offset) -> Gaussians:
    """Gaussians under a transformation that turns, moves and scales evenly, without an offset."""
    world = world.copy()
    world[:3, 3] -= offset
    if np.array_equal(world, np.eye(4)):
        return part
    scale = np.cbrt(np.linalg.det(world[:3, :3]))
    turn = world[:3, :3] / scale if scale > 0 else np.zeros((3, 3))
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3):
        raise ValueError("nodes that mirror, shear or scale unevenly are not read")
    columns = (torch.from_numpy(np.array(values, np.float32)) for values in (scale, turn, world[:3, 3]))
    return Similarity(*columns).gaussians(part)
