"""Where a picture of a scene shows what photographs have shown."""

from dataclasses import dataclass
from math import radians

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.types import Cameras, Gaussians, Value

POINTS, OPAQUE = 8000, 0.3
"""At most this many centres are looked at, evenly spaced in their order, of Gaussians of more than this opacity."""
SPACING, BEYOND = (radians(12), radians(30)), radians(18)
"""Confidence falls where directions differ by more than those of neighbouring photographs do, by their 0.9 quantile
within these bounds, and is 0 from that angle beyond."""
MARGIN = 0.01
"""Photographs are taken for wider by this share of their sides on each: a point on a border is in the image."""
CELLS = (12, 16)
"""Rows and columns of a picture in which confidence is measured."""
BEHIND = 1.15
"""What is farther than this many times the nearest of its cell is hidden there."""
NEAR, FAR = 1.0, 4.0
"""Standard deviations in cells of the mean over neighbours, and of that for cells which have no near ones."""


@dataclass(frozen=True)
class ViewConfidence(Value):
    """How well it is known what a view shows: 1 where photographs show it from about the same direction, down to 0.

    From other directions a point may be a smear, stand in the air, or hide what is behind it. Each cell of the picture
    takes the mean of the points that are in front there, and pixels are interpolated; where there are no points at all
    it is 1.

    Args:
        points: Centres of the Gaussians that are looked at.
        directions: Unit vectors from points to cameras; 0 where a point is not in the image.
        spacing: The angle in radians up to which a direction counts as that of a photograph.
    """

    points: Float[Tensor, "P 3"]
    directions: Float[Tensor, "V P 3"]
    spacing: float

    @classmethod
    def of(cls, gaussians: Gaussians, cameras: Cameras) -> "ViewConfidence":
        """Of a batch of one scene and the cameras of its photographs."""
        points = gaussians.means[0, gaussians.opacities[0] > OPAQUE]
        points = points[:: -(-len(points) // POINTS) or 1]
        inside = projected(points, cameras, MARGIN)[1]
        directions = F.normalize(cameras.world_from_camera[0, :, None, :3, 3] - points, dim=-1) * inside[..., None]
        nearest = _nearest_cosines(directions[:, ::8])
        between, (least, most) = torch.acos(nearest[nearest > 0].clamp(max=1)), SPACING
        return cls(points, directions, min(max(float(between.quantile(0.9)), least), most) if len(between) else least)

    def __call__(self, camera: Cameras) -> Float[Tensor, "1 H W"]:
        """In [0, 1], of each pixel of one camera."""
        (position,), (inside,) = projected(self.points, camera)
        sides = self.points.new_tensor([CELLS[1] / camera.size[1], CELLS[0] / camera.size[0]])
        last = torch.tensor([CELLS[1] - 1, CELLS[0] - 1], device=sides.device)
        column, row = (position[inside, :2] * sides).long().minimum(last).unbind(1)  # a product may be rounded up
        depth, cell = position[inside, 2], row * CELLS[1] + column
        towards = F.normalize(camera.world_from_camera[0, 0, :3, 3] - self.points[inside], dim=-1)
        angle = torch.acos((self.directions[:, inside] * towards).sum(-1).amax(0).clamp(-1, 1))
        beyond = ((angle - self.spacing) / BEYOND).clamp(0, 1)
        known = 1 - beyond.square() * (3 - 2 * beyond)
        empty = depth.new_zeros(CELLS[0] * CELLS[1])
        nearest = torch.full_like(empty, torch.inf).scatter_reduce(0, cell, depth, "amin")
        front = (depth <= BEHIND * nearest[cell]).to(depth)
        count, total = empty.scatter_add(0, cell, front), empty.scatter_add(0, cell, front * known)
        places = torch.cartesian_prod(torch.arange(CELLS[0]), torch.arange(CELLS[1])).to(depth)
        apart = torch.cdist(places, places).square() / 2
        # The second term only counts for cells that have no neighbours with points.
        weights = (torch.exp(-apart / NEAR**2) + 1e-6 * torch.exp(-apart / FAR**2)) * (count > 0)
        mean = (weights * (total / count.clamp_min(1))).sum(1) / weights.sum(1)  # not a number if there are no points
        return F.interpolate(mean.nan_to_num(1.0).view(1, 1, *CELLS), camera.size, mode="bilinear")[0].clamp(0, 1)


def _nearest_cosines(directions: Float[Tensor, "V P 3"]) -> Float[Tensor, "V P"]:
    """Of the angles between each direction and the nearest of another view."""
    nearest = []
    for view, own in enumerate(directions):
        cosines = (directions * own).sum(-1)
        cosines[view] = -1
        nearest.append(cosines.amax(0))
    return torch.stack(nearest)


def projected(
    points: Float[Tensor, "P 3"], cameras: Cameras, margin: float = 0.0
) -> tuple[Float[Tensor, "V P 3"], Bool[Tensor, "V P"]]:
    """Pixels and depths of points in all views of one scene, and whether they are in the image."""
    motion, size = cameras.camera_from_world[0].to(points), points.new_tensor(cameras.size[::-1])
    local = points @ motion[:, :3, :3].mT + motion[:, None, :3, 3]
    depth = local[..., 2:]
    pixels = (local @ cameras.intrinsics[0].to(points).mT)[..., :2] / depth.clamp_min(1e-12)
    inside = (pixels >= -margin * size) & (pixels < (1 + margin) * size)
    return torch.cat([pixels, depth], dim=-1), inside.all(-1) & (depth[..., 0] > 0)
