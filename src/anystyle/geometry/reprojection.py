"""Reprojection of the pixels of one view into another, by depth and cameras."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor


class Reprojected(NamedTuple):
    """The points of a source view's pixels as the target's camera has them.

    Args:
        displacement: (x, y) in pixels, to be added to the source pixel.
        depth: Along the target's z axis.
        inside: Whether there is a point, in front of the target's camera and within its image.
    """

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
    height, width = depth.shape[-2:]
    y = torch.arange(height, dtype=depth.dtype, device=depth.device) + 0.5
    x = torch.arange(width, dtype=depth.dtype, device=depth.device) + 0.5
    y, x = torch.meshgrid(y, x, indexing="ij")
    pixels = torch.stack([x, y, torch.ones_like(x)]).flatten(1)  # 3 HW
    points = torch.linalg.solve(source_intrinsics, pixels.expand(depth.shape[0], -1, -1)) * depth.flatten(1)[:, None]
    in_target = target_from_source[:, :3, :3] @ points + target_from_source[:, :3, 3:]
    homogeneous = target_intrinsics @ in_target
    projected = homogeneous[:, :2] / homogeneous[:, 2:].clamp_min(1e-8)  # M 2 HW
    limit = projected.new_tensor([[width], [height]])
    inside = ((projected >= 0) & (projected <= limit)).all(1) & (in_target[:, 2] > 0) & (depth.flatten(1) > 0)
    shape = (height, width)
    return Reprojected(
        (projected - pixels[:2]).unflatten(2, shape), in_target[:, 2].unflatten(1, shape), inside.unflatten(1, shape)
    )


def depth_around(
    depth: Float[Tensor, "M H W"], displacement: Float[Tensor, "M 2 H W"]
) -> tuple[Float[Tensor, "M H W"], Float[Tensor, "M H W"]]:
    """The least and the greatest of the four depths around each displaced pixel; outside the image, of its border.

    Interpolated depth would be that of neither side at an edge.
    """
    height, width = depth.shape[-2:]
    y = torch.arange(height, dtype=depth.dtype, device=depth.device)[:, None] + displacement[:, 1]
    x = torch.arange(width, dtype=depth.dtype, device=depth.device) + displacement[:, 0]
    neighbours = []
    for down in (torch.floor, torch.ceil):
        for across in (torch.floor, torch.ceil):
            column, row = across(x).clamp(0, width - 1).long(), down(y).clamp(0, height - 1).long()
            neighbours.append(
                depth.flatten(1).gather(1, (row * width + column).flatten(1)).unflatten(1, (height, width))
            )
    depths = torch.stack(neighbours)
    return depths.amin(0), depths.amax(0)
