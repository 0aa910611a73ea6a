"""Which of a scene's cameras shows most of it."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.confidence import projected
from anystyle.types import Cameras

_POINTS = 20_000
"""Gaussians that are looked at, evenly spaced in their order."""
_OPAQUE = 0.3
_CELLS = (18, 24)
"""Rows and columns into which a picture is divided."""
_BEHIND = 1.15
"""What is farther than this many times the nearest of its cell is hidden there."""


def best_view(means: Float[Tensor, "N 3"], opacities: Float[Tensor, " N"], cameras: Cameras) -> int:
    """The camera that shows most Gaussians that another shows, too, in a picture filled with such; the first of equals.

    The number of these Gaussians is multiplied by the mean of their share of what is seen in each cell of the picture:
    what one photograph alone has seen, and what lies outside of all of them, speaks against a view.
    """
    points = means.cpu()[opacities.cpu() > _OPAQUE]
    points = points[:: -(-len(points) // _POINTS) or 1]
    rows, columns = _CELLS
    (height, width), count = cameras.size, rows * columns
    position, inside = projected(points, cameras)
    column, row, depth = position.unbind(-1)
    row, column = (row * rows / height).floor(), (column * columns / width).floor()
    cell = torch.where(inside, row * columns + column, count).long()  # the last is outside
    nearest = torch.full((len(inside), count + 1), torch.inf).scatter_reduce(1, cell, depth, "amin")
    seen = (inside & (depth <= _BEHIND * nearest.gather(1, cell))).float()
    shared = seen * (seen.sum(0) > 1)
    sums, counts = (torch.zeros(len(inside), count + 1).scatter_add(1, cell, each) for each in (shared, seen))
    return int((shared.sum(1) * (sums / counts.clamp_min(1))[:, :count].mean(1)).argmax())
