"""Moving images along a flow, and pixels from one view into another."""

from itertools import product
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor


def sample_at(
    image: Float[Tensor, "M C H W"], flow: Float[Tensor, "M 2 H W"], mode: str = "bilinear", outside: str = "zeros"
) -> Float[Tensor, "M C H W"]:
    """Sample ``image`` at each pixel's centre displaced by ``flow`` pixels; ``outside`` is a mode of padding."""
    grid = (pixels(flow) + 0.5 + flow).movedim(1, -1) * 2 / flow.new_tensor(image.shape[:1:-1]) - 1
    return F.grid_sample(image, grid, mode=mode, padding_mode=outside, align_corners=False)


def pixels(like: Float[Tensor, "*batch H W"]) -> Float[Tensor, "2 H W"]:
    """Column and row of each pixel, counted from 0, with the dtype and device of ``like``."""
    ranges = (torch.arange(side, dtype=like.dtype, device=like.device) for side in like.shape[:-3:-1])
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


def backward_warp(image: Float[Tensor, "M C H W"], flow: Float[Tensor, "M 2 H W"]) -> Float[Tensor, "M C H W"]:
    """Sample ``image`` at each pixel displaced by ``flow``, (x, y) in pixels; zero outside.

    The published evaluation's sampling, kept to the digit: the flow is scaled by ``2 / (size - 1)`` although the grid
    holds pixel centres, so long displacements are overshot by one part in ``size``.
    """
    height, width = image.shape[-2:]
    x = torch.linspace(-1 + 1 / width, 1 - 1 / width, width, dtype=flow.dtype, device=flow.device)
    y = torch.linspace(-1 + 1 / height, 1 - 1 / height, height, dtype=flow.dtype, device=flow.device)
    grid = torch.stack(
        [x + flow[:, 0] * (2 / max(width - 1, 1)), y[:, None] + flow[:, 1] * (2 / max(height - 1, 1))], dim=-1
    )
    return F.grid_sample(image, grid, mode="bilinear", padding_mode="zeros", align_corners=False)


class ForwardWarp(NamedTuple):
    """A forward-warped image: the weighted mean of what falls onto each pixel, or 0, and the sum of weights."""

    image: Float[Tensor, "M C H W"]
    weight: Float[Tensor, "M 1 H W"]


def softmax_splat(
    image: Float[Tensor, "M C H W"], flow: Float[Tensor, "M 2 H W"], importance: Float[Tensor, "M 1 H W"]
) -> ForwardWarp:
    """Move pixels along a flow, (x, y) in pixels, onto their four neighbours, weighted by ``exp(importance)``.

    Softmax splatting (Niklaus and Liu, CVPR 2020) as the published consistency script uses it: what falls outside is
    dropped, as is a pixel whose flow is not finite, and the sum is divided by the weight plus 1e-7.
    """
    count, channels, height, width = image.shape
    weight = importance.exp()
    source = torch.cat([image * weight, weight], dim=1).flatten(2)  # M C+1 HW
    x, y = (pixels(flow) + flow).unbind(1)
    finite = x.isfinite() & y.isfinite()
    x, y = x.nan_to_num(-9.0, -9.0, -9.0), y.nan_to_num(-9.0, -9.0, -9.0)
    left, top = x.floor(), y.floor()
    total = source.new_zeros(count, channels + 1, height * width)
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column, row = left + dx, top + dy
        bilinear = (1 - (x - column).abs()) * (1 - (y - row).abs())
        inside = finite & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        index = (row.clamp(0, height - 1) * width + column.clamp(0, width - 1)).long().flatten(1)
        contribution = source * (bilinear * inside).flatten(1)[:, None]
        total.scatter_add_(2, index[:, None].expand_as(contribution), contribution)
    image_sum, weight_sum = total[:, :channels], total[:, channels:]
    return ForwardWarp(
        image=(image_sum / (weight_sum + 1e-7)).unflatten(2, (height, width)),
        weight=weight_sum.unflatten(2, (height, width)),
    )
