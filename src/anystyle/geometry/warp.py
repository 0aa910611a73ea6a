"""Moving images along a flow, and pixels from one view into another."""

from itertools import product
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor


def sample_at(image: Float[Tensor, "M C H W"], flow: Float[Tensor, "M 2 H W"]) -> Float[Tensor, "M C H W"]:
    """Sample ``image`` at each pixel's centre displaced by ``flow`` pixels, exactly; zero outside."""
    height, width = image.shape[-2:]
    centres = (pixels(flow) + 0.5 + flow).movedim(1, -1)
    grid = centres * flow.new_tensor([2 / width, 2 / height]) - 1
    return F.grid_sample(image, grid, mode="bilinear", padding_mode="zeros", align_corners=False)


def pixels(like: Float[Tensor, "*batch H W"]) -> Float[Tensor, "2 H W"]:
    """Column and row of each pixel, counted from 0, with the dtype and device of ``like``."""
    height, width = like.shape[-2:]
    ranges = (torch.arange(side, dtype=like.dtype, device=like.device) for side in (width, height))
    return torch.stack(torch.meshgrid(*ranges, indexing="xy"))


class Reprojected(NamedTuple):
    """Displacements (x, y) of a source view's pixels into the target, depth there, and whether the target sees them."""

    displacement: Float[Tensor, "M 2 H W"]
    depth: Float[Tensor, "M H W"]
    inside: Bool[Tensor, "M H W"]


def reproject(
    depth: Float[Tensor, "M H W"],
    source_intrinsics: Float[Tensor, "M 3 3"],
    target_intrinsics: Float[Tensor, "M 3 3"],
    target_from_source: Float[Tensor, "M 4 4"],
) -> Reprojected:
    """Move every pixel's point into the target's camera; depth is along the source's z axis, 0 where unknown."""
    shape = height, width = depth.shape[-2:]
    centres = F.pad((pixels(depth) + 0.5).flatten(1), (0, 0, 0, 1), value=1.0)  # 3 HW
    points = torch.linalg.solve(source_intrinsics, centres.expand(depth.shape[0], -1, -1)) * depth.flatten(1)[:, None]
    in_target = target_from_source[:, :3, :3] @ points + target_from_source[:, :3, 3:]
    homogeneous = target_intrinsics @ in_target
    projected = homogeneous[:, :2] / homogeneous[:, 2:].clamp_min(1e-8)  # M 2 HW
    limit = projected.new_tensor([[width], [height]])
    inside = ((projected >= 0) & (projected <= limit)).all(1) & (in_target[:, 2] > 0) & (depth.flatten(1) > 0)
    return Reprojected(
        (projected - centres[:2]).unflatten(2, shape), in_target[:, 2].unflatten(1, shape), inside.unflatten(1, shape)
    )


def depth_around(
    depth: Float[Tensor, "M H W"], displacement: Float[Tensor, "M 2 H W"]
) -> tuple[Float[Tensor, "M H W"], Float[Tensor, "M H W"]]:
    """The least and the greatest of the four depths around each displaced pixel; outside the image, of its border.

    Interpolated depth would be that of neither side at an edge.
    """
    height, width = depth.shape[-2:]
    x, y = (pixels(depth) + displacement).unbind(1)
    neighbours = []
    for down, across in product((torch.floor, torch.ceil), repeat=2):
        column, row = across(x).clamp(0, width - 1).long(), down(y).clamp(0, height - 1).long()
        neighbours.append(depth.flatten(1).gather(1, (row * width + column).flatten(1)).view_as(depth))
    depths = torch.stack(neighbours)
    return depths.amin(0), depths.amax(0)
