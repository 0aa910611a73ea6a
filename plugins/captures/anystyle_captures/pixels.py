"""Where points lie in photographs."""

from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor

from anystyle.types import Cameras


class Pixels(NamedTuple):
    """The pixels of one view in which points lie, or the nearest where a view does not show a point."""

    row: Int[Tensor, " N"]
    column: Int[Tensor, " N"]
    depth: Float[Tensor, " N"]
    within: Bool[Tensor, " N"]  # before the camera and in its image


def pixels_of(points: Float[Tensor, "N 3"], cameras: Cameras, view: int) -> Pixels:
    """Project points to a view of the one scene."""
    motion = cameras.camera_from_world[0, view]
    local = points @ motion[:3, :3].T + motion[:3, 3]
    image = local @ cameras.intrinsics[0, view].T
    column, row = (image[:, :2] / image[:, 2:].clamp_min(1e-12)).floor().long().unbind(1)
    height, width = cameras.size
    within = (local[:, 2] > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    return Pixels(row.clamp(0, height - 1), column.clamp(0, width - 1), local[:, 2], within)
