"""Where points lie in photographs."""

from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor

from anystyle.geometry.confidence import projected
from anystyle.types import Cameras


class Pixels(NamedTuple):
    """The pixels of one view in which points lie, or the nearest where a view does not show a point."""

    row: Int[Tensor, " N"]
    column: Int[Tensor, " N"]
    depth: Float[Tensor, " N"]
    within: Bool[Tensor, " N"]  # before the camera and in its image


def pixels_of(points: Float[Tensor, "N 3"], cameras: Cameras, view: int) -> Pixels:
    """Project points to a view of the one scene."""
    (position,), (within,) = projected(points, cameras.select([view]))
    column, row = position[:, :2].long().unbind(1)
    height, width = cameras.size
    return Pixels(row.clamp(0, height - 1), column.clamp(0, width - 1), position[:, 2], within)
