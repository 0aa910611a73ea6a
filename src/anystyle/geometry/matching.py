"""Which points of two photographs look alike: patches compared with a preference for where geometry expects them."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

PATCH = 7
"""Samples a side of a patch."""
SCALES = ((1.0, 2), (2.0, 4))
"""Blur and spacing of samples, in pixels, of each of the patches around a point."""
CHANNELS = 48
"""Principal components of patches that are compared."""
LEAST_ALIKE = 0.3
"""Points that look less alike are not matched."""
PATCH_NOISE = 0.15
"""Contrast, as the norm of a patch's samples, below which a patch says little."""


class Matches(NamedTuple):
    """Points of one image that were found in another.

    Args:
        source: Which of the source's points.
        place: Where each was found in the target, in pixels.
        alike: How alike the patches are, up to 1.
    """

    source: Int[Tensor, " m"]
    place: Float[Tensor, "m 2"]
    alike: Float[Tensor, " m"]


def grid_points(size: tuple[int, int], stride: int, device: torch.device | None = None) -> Float[Tensor, "N 2"]:
    """Centres of every so manieth pixel, row by row, as (x, y)."""
    y, x = torch.meshgrid(
        torch.arange(0, size[0], stride, device=device), torch.arange(0, size[1], stride, device=device), indexing="ij"
    )
    return torch.stack([x, y], dim=-1).flatten(0, 1) + 0.5


def describe_points(images: Float[Tensor, "V 3 H W"], stride: int) -> Float[Tensor, "V N C"]:
    """Patches around every so manieth pixel, without their mean colour, as their principal components in these images.

    Products of two descriptors say how alike two points look, whatever the exposure: about 1 for the same patch.
    """
    parts: list[Tensor] = []
    reach = torch.arange(PATCH, device=images.device) - PATCH // 2
    window = torch.exp(-(reach[:, None].square() + reach.square()) / 16).flatten().repeat(3)  # 3 P²
    for blur, spacing in SCALES:
        margin = PATCH // 2 * spacing
        padded = F.pad(_blurred(images, blur), (margin, margin, margin, margin), mode="replicate")
        patches = F.unfold(padded, PATCH, dilation=spacing, stride=stride).unflatten(1, (3, -1))  # V 3 P² N
        patches = (patches - patches.mean(2, keepdim=True)).flatten(1, 2) * window[:, None]
        parts.append(patches / (patches.norm(dim=1, keepdim=True) + PATCH_NOISE))
    found = torch.cat(parts, dim=1).mT / len(SCALES) ** 0.5  # V N C
    flat = found.flatten(0, 1)
    axes = torch.linalg.eigh(flat.mT @ flat).eigenvectors[:, -CHANNELS:]
    return found @ axes


def match_points(
    alike: Float[Tensor, "N M"],
    points: Float[Tensor, "N 2"],
    cells: Float[Tensor, "M 2"],
    expected: Float[Tensor, "N 2"],
    *,
    columns: int,
    reach: float,
    trust: float = 20.0,
    doubt: float = 4.0,
) -> Matches:
    """The mutual best matches of points of one image in another, between the target's cells.

    Args:
        alike: How alike each point and each of the target's cells are.
        points: Of the source, in pixels.
        cells: Of the target, in pixels, row by row.
        expected: Where each point should be in the target if the geometry were right.
        columns: Cells a row.
        reach: Pixels around there within which a match costs little.
        trust: What a likeness of 1 is worth.
        doubt: What being far away costs at the most; so a match may lie anywhere if it is good enough.
    """
    distance = torch.cdist(expected[None], cells[None])[0]
    worth = alike * trust - (distance / reach).square().clamp_max(doubt)
    best = worth.argmax(1)
    back = worth.argmax(0)[best]
    spacing = float((cells[1] - cells[0]).norm())
    row, column = best // columns, best % columns
    rows = len(cells) // columns
    # A point returns to itself or to a neighbour on the source's coarser grid.
    kept = (points[back] - points).norm(dim=-1) <= 2.1 * spacing
    kept &= (row > 0) & (row < rows - 1) & (column > 0) & (column < columns - 1)
    kept &= alike.gather(1, best[:, None])[:, 0] >= LEAST_ALIKE
    source = kept.nonzero().squeeze(1)
    best = best[source]
    centre = alike[source, best]
    shift = [_peak(alike[source, best - step], centre, alike[source, best + step]) for step in (1, columns)]
    return Matches(source, cells[best] + spacing * torch.stack(shift, dim=-1), centre)


def _peak(before: Float[Tensor, " m"], centre: Float[Tensor, " m"], after: Float[Tensor, " m"]) -> Float[Tensor, " m"]:
    """Where the parabola through three samples peaks, in [-0.5, 0.5] samples of the middle one."""
    return (0.5 * (before - after) / (before - 2 * centre + after).clamp_max(-1e-4)).clamp(-0.5, 0.5)


def _blurred(images: Float[Tensor, "V 3 H W"], sigma: float) -> Float[Tensor, "V 3 H W"]:
    reach = round(3 * sigma)
    taps = torch.exp(-torch.arange(-reach, reach + 1, device=images.device).square() / (2 * sigma**2))
    taps = (taps / taps.sum()).to(images.dtype)
    row = taps.expand(3, 1, 1, -1)
    across = F.conv2d(F.pad(images, (reach, reach, 0, 0), mode="replicate"), row, groups=3)
    return F.conv2d(F.pad(across, (0, 0, reach, reach), mode="replicate"), row.mT, groups=3)
