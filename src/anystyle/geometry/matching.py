"""Patch matching between two photographs, with a prior on the position of each match."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from kornia.filters import gaussian_blur2d
from torch import Tensor

PATCH = 7
"""Samples along a side of a patch."""
SCALES = ((1.0, 2), (2.0, 4))
"""For each patch around a point: standard deviation of the blur and spacing of the samples, in pixels."""
CHANNELS = 48
"""Principal components of patches that are compared."""
MIN_SIMILARITY = 0.3
"""Points with a lower similarity are not matched."""
PATCH_NOISE = 0.15
"""Added to the norm of a patch's samples, so that patches of little contrast have short descriptors."""


class PatchMatches(NamedTuple):
    """Matched points of two images.

    Args:
        source: Indices of the source's points.
        pixel: Position of each match in the target, (x, y) in pixels.
        similarity: Of the two patches, up to 1.
    """

    source: Int[Tensor, " m"]
    pixel: Float[Tensor, "m 2"]
    similarity: Float[Tensor, " m"]


def grid_points(size: tuple[int, int], stride: int, device: torch.device | None = None) -> Float[Tensor, "N 2"]:
    """Centres of every ``stride``-th pixel, row by row, as (x, y) in pixels."""
    y, x = torch.meshgrid(
        torch.arange(0, size[0], stride, device=device), torch.arange(0, size[1], stride, device=device), indexing="ij"
    )
    return torch.stack([x, y], dim=-1).flatten(0, 1) + 0.5


def describe_points(images: Float[Tensor, "V 3 H W"], stride: int) -> Float[Tensor, "V N C"]:
    """Descriptors of every ``stride``-th pixel: the principal components, in these images, of patches around it.

    Patches are without their mean colour. The dot product of two descriptors is their similarity, invariant to
    exposure: about 1 for the same patch.
    """
    parts: list[Tensor] = []
    offset = torch.arange(PATCH, device=images.device) - PATCH // 2
    window = torch.exp(-(offset[:, None].square() + offset.square()) / 16).flatten().repeat(3)  # 3 P²
    for blur, spacing in SCALES:
        margin = PATCH // 2 * spacing
        blurred = gaussian_blur2d(images, 2 * round(3 * blur) + 1, (blur, blur), border_type="replicate")
        padded = F.pad(blurred, (margin, margin, margin, margin), mode="replicate")
        patches = F.unfold(padded, PATCH, dilation=spacing, stride=stride).unflatten(1, (3, -1))  # V 3 P² N
        patches = (patches - patches.mean(2, keepdim=True)).flatten(1, 2) * window[:, None]
        parts.append(patches / (patches.norm(dim=1, keepdim=True) + PATCH_NOISE))
    descriptors = torch.cat(parts, dim=1).mT / len(SCALES) ** 0.5  # V N C
    flat = descriptors.flatten(0, 1)
    axes = torch.linalg.eigh(flat.mT @ flat).eigenvectors[:, -CHANNELS:]
    return descriptors @ axes


def match_points(
    similarity: Float[Tensor, "N M"],
    points: Float[Tensor, "N 2"],
    cells: Float[Tensor, "M 2"],
    expected: Float[Tensor, "N 2"],
    *,
    num_columns: int,
    radius: float,
    trust: float = 20.0,
    doubt: float = 4.0,
) -> PatchMatches:
    """The mutual best matches of points of one image in another, to a fraction of the target's cells.

    Args:
        similarity: Of each point with each of the target's cells.
        points: Of the source, in pixels.
        cells: Of the target, in pixels, row by row.
        expected: Positions of the points in the target by the predicted geometry, in pixels.
        num_columns: Cells in a row.
        radius: Distance in pixels from the expected position at which a match costs 1.
        trust: Score of a similarity of 1.
        doubt: The largest cost of a distance, so that a good match may lie anywhere.
    """
    distance = torch.cdist(expected[None], cells[None])[0]
    score = similarity * trust - (distance / radius).square().clamp_max(doubt)
    best = score.argmax(1)
    back = score.argmax(0)[best]
    spacing = float((cells[1] - cells[0]).norm())
    row, column = best // num_columns, best % num_columns
    num_rows = len(cells) // num_columns
    # A point returns to itself or to a neighbour on the source's coarser grid.
    kept = (points[back] - points).norm(dim=-1) <= 2.1 * spacing
    kept &= (row > 0) & (row < num_rows - 1) & (column > 0) & (column < num_columns - 1)
    kept &= similarity.gather(1, best[:, None])[:, 0] >= MIN_SIMILARITY
    source = kept.nonzero().squeeze(1)
    best = best[source]
    centre = similarity[source, best]
    shift = [
        _peak(similarity[source, best - step], centre, similarity[source, best + step]) for step in (1, num_columns)
    ]
    return PatchMatches(source, cells[best] + spacing * torch.stack(shift, dim=-1), centre)


def _peak(before: Float[Tensor, " m"], centre: Float[Tensor, " m"], after: Float[Tensor, " m"]) -> Float[Tensor, " m"]:
    """Position of the peak of the parabola through three samples, in [-0.5, 0.5] samples from the middle one."""
    return (0.5 * (before - after) / (before - 2 * centre + after).clamp_max(-1e-4)).clamp(-0.5, 0.5)
