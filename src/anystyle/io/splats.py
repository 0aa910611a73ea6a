"""Gaussians as files hold them: rows that show nothing are left out, and coordinates far from the origin moved to it.

Readers of every format end here, so that all treat such rows alike and tell what they did in the same words.
"""

import logging
from collections import Counter
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from torch import Tensor

from anystyle.errors import UserError

_log = logging.getLogger(__name__)

FAR = 1e4
"""Coordinates from which on float32 has steps of a thousandth."""
_LARGEST = torch.finfo(torch.float32).max ** 0.5
"""Of numbers whose squares, such as variances, are finite."""

Offset = tuple[float, float, float]
NEAR: Offset = (0.0, 0.0, 0.0)
"""The offset of positions that are as the file has them."""


class Splats(NamedTuple):
    """The tensors of one scene, with the meaning that :class:`anystyle.types.Gaussians` gives them."""

    means: Float[Tensor, "N 3"]
    rotations: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    harmonics: Float[Tensor, "N K 3"]


@dataclass
class Remarks:
    """What a reader does to the rows of a file beyond decoding them; told once the file is read."""

    path: Path
    guesses: list[str] = field(default_factory=list)
    """What the file leaves open, and how it was read, one line each."""
    total: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    """Rows that show nothing, by what is wrong with them."""
    kept: Counter[str] = field(default_factory=Counter)
    """Rows with infinite numbers that say something, by what that is."""

    def tell(self) -> None:
        """Log a line on the rows, and one on each guess."""
        left_out, kept = _counts(self.left_out), _counts(self.kept)
        rows = [f"of {self.total:,} Gaussians, all kept, {kept}"] if kept else []
        if left_out:
            number, more = f"{self.left_out.total():,} of {self.total:,}", kept and f"; kept are {kept}"
            rows = [f"{number} Gaussians are left out ({left_out}){more}"]
        for line in (*rows, *dict.fromkeys(self.guesses)):
            _log.warning("%s: %s", self.path, line)


def visible(
    rows: Splats, remarks: Remarks, *, logarithmic: bool = False, activated: bool = False
) -> tuple[Splats, Bool[Tensor, " N"]]:
    """The Gaussians of a file that show something, and which of its rows they are.

    An infinite opacity is 1, and a scale with the logarithm of minus infinity is 0: a flat disc. Rows are left out
    whose opacity is minus infinity, or in which a number is NaN, infinite, or too large for its square to be finite.

    Args:
        rows: The numbers of the file as float32; two scales are those of a disc.
        remarks: Counts what is left out.
        logarithmic: Whether files of the format hold logarithms of scales and logits of opacities.
        activated: Whether this one holds lengths and opacities in [0, 1] nevertheless.

    Raises:
        UserError: No row is left.
    """
    means, rotations, scales, opacities, harmonics = rows
    lengths, fractions = _activated(scales, opacities, remarks, activated) if logarithmic else (True, True)
    sizes = scales if lengths else scales.exp()
    alphas = opacities.clamp(0, 1) if fractions else opacities.sigmoid()
    problems = {
        "without a position": _unusable(means),
        "with opacity -inf": opacities == -inf,
        "without an opacity": alphas.isnan(),
        "with an infinite, negative or missing scale": _unusable(sizes) | (sizes < 0).any(1),
        "without a rotation": _unusable(rotations),
        "without a colour": _unusable(harmonics),
    }
    kept = torch.ones(len(means), dtype=torch.bool)
    for what, wrong in problems.items():
        remarks.left_out[what] += int((wrong & kept).sum())
        kept &= ~wrong
    remarks.total += len(means)
    if not bool(kept.any()):
        reason = _counts(remarks.left_out) or "it is empty"
        raise UserError(f"{remarks.path} has no Gaussians that can be shown ({reason}); export it again")
    remarks.kept["with opacity +inf, as opaque"] += int((kept & (opacities == inf)).sum())
    remarks.kept["with scale -inf, as flat"] += int((kept & (scales == -inf).any(1)).sum())
    splats = Splats(means, rotations, F.pad(sizes, (0, 3 - sizes.shape[1])), alphas, harmonics)
    return (splats if bool(kept.all()) else Splats(*(column[kept] for column in splats))), kept


def _counts(rows: Counter[str]) -> str:
    return ", ".join(f"{count:,} {what}" for what, count in rows.items() if count)


def _unusable(numbers: Float[Tensor, " N *rest"]) -> Bool[Tensor, " N"]:
    return ~(numbers.abs() < _LARGEST).flatten(1).all(1)


def _activated(
    scales: Float[Tensor, "N S"], opacities: Float[Tensor, " N"], remarks: Remarks, asked: bool
) -> tuple[bool, bool]:
    """Whether scales are lengths and opacities in [0, 1] where logarithms and logits are expected."""
    sizes, alphas = (column[column.isfinite()] for column in (scales, opacities))
    # A few lengths may be damaged; a scene whose logarithms are not negative has Gaussians of a unit or more.
    lengths = len(sizes) > 0 and float((sizes < 0).float().mean()) < 0.01
    fractions = len(alphas) > 0 and bool(((alphas >= 0) & (alphas <= 1)).all())
    if asked:
        if lengths or fractions:
            return lengths, fractions
        found = "scales that are negative and opacities out of 0 to 1"
        raise UserError(f"{remarks.path} has {found}, and splat.activated=true; leave that out")
    small = lengths and (fractions or float(sizes.median()) < 0.5)
    varied = fractions and (small or bool(alphas.min() < alphas.max()))
    found = [*(["scales look like lengths"] if small else []), *(["opacities like fractions"] if varied else [])]
    if found:
        read = "are read as logarithms and logits, as the format has them; if that is wrong, add splat.activated=true"
        remarks.guesses.append(f"{' and '.join(found)}, and {read}")
    return False, False


def near(means: NDArray[np.floating], remarks: Remarks) -> tuple[NDArray[np.float32], Offset]:
    """Positions as float32, and what was taken off those that float32 would round, in whole units.

    Example:
        >>> means, offset = near(np.array([[4500000.01, 2, 3], [4500000.02, 2, 3]]), Remarks(Path("scene.ply")))
        >>> means[:, 0], offset
        (array([0.01, 0.02], dtype=float32), (4500000.0, 0.0, 0.0))
    """
    with np.errstate(all="ignore"):
        sound = means[np.isfinite(means).all(1)]
        offset = offset_of(sound, remarks) if (sound.astype(np.float32) != sound).any() else NEAR
        return (means - offset if any(offset) else means).astype(np.float32), offset


def offset_of(positions: NDArray[np.floating], remarks: Remarks) -> Offset:
    """What is taken off positions so that float32 tells them apart: along each axis their middle, where that is far."""
    middle = np.median(positions, axis=0).round()
    x, y, z = np.where(np.abs(middle) > FAR, middle, 0.0).tolist()
    if any((x, y, z)):
        remarks.guesses.append(f"{x:.17g} {y:.17g} {z:.17g} is taken off all positions, which float32 would round")
    return x, y, z
