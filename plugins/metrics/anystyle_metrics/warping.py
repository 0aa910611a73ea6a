"""Moving images along a flow as the published consistency script does: backward sampling and forward splatting."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.warp import pixels


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
