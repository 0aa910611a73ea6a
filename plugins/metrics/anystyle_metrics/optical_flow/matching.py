"""Optical flow without weights: full search on blurred windows at a quarter of the size, then refinement.

The stand-in for RAFT where its weights are missing. It follows displacements of up to 32 pixels, on textures.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.warp import sample_at

RADIUS = 8  # of the search, in pixels at a quarter of the size
DAMPING = 1e-4  # added to squared gradients: windows without any texture do not move


def match(source: Float[Tensor, "M 3 H W"], target: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 2 H W"]:
    """The flow, (x, y) in pixels, between sRGB images in [0, 1], pair by pair."""
    height, width = source.shape[-2:]
    quarter = (max(8, height // 4), max(8, width // 4))
    flow = _search(*(F.interpolate(frames, size=quarter, mode="area") for frames in (source, target)))
    for size in (quarter, (max(8, height // 2), max(8, width // 2)), (height, width)):
        flow = _resize(flow, size)
        pair = [F.interpolate(frames, size=size, mode="area") for frames in (source, target)]
        for _ in range(4):
            flow = flow + _update(pair[0], pair[1], flow)
    return flow


def _search(source: Tensor, target: Tensor) -> Float[Tensor, "M 2 h w"]:
    """The displacement in whole pixels with the smallest difference in a window; the shortest of equals."""
    height, width = source.shape[-2:]
    padded = F.pad(target, (RADIUS,) * 4, mode="replicate")
    steps = [(dx, dy) for dy in range(-RADIUS, RADIUS + 1) for dx in range(-RADIUS, RADIUS + 1)]
    steps.sort(key=lambda step: step[0] ** 2 + step[1] ** 2)
    best = torch.full_like(source[:, :1], torch.inf)
    flow = torch.zeros_like(source[:, :2])
    for dx, dy in steps:
        shifted = padded[:, :, RADIUS + dy : RADIUS + dy + height, RADIUS + dx : RADIUS + dx + width]
        cost = _window((source - shifted).abs().sum(1, keepdim=True), 7)
        better = cost < best - 1e-6
        best = torch.where(better, cost, best)
        flow = torch.where(better, flow.new_tensor([dx, dy]).view(1, 2, 1, 1), flow)
    return flow


def _update(source: Tensor, target: Tensor, flow: Tensor) -> Float[Tensor, "M 2 h w"]:
    """One least-squares step in each window (Lucas and Kanade 1981), at most one pixel along each axis."""
    error = (source - sample_at(target, flow)) * sample_at(torch.ones_like(target[:, :1]), flow)
    padded = F.pad(source, (1, 1, 1, 1), mode="replicate")
    dx = (padded[:, :, 1:-1, 2:] - padded[:, :, 1:-1, :-2]) / 2
    dy = (padded[:, :, 2:, 1:-1] - padded[:, :, :-2, 1:-1]) / 2
    xx, xy, yy = (_window((a * b).sum(1, keepdim=True), 9) for a, b in ((dx, dx), (dx, dy), (dy, dy)))
    bx, by = (_window((slope * error).sum(1, keepdim=True), 9) for slope in (dx, dy))
    xx, yy = xx + DAMPING, yy + DAMPING
    determinant = xx * yy - xy.square()
    # The gradients of the source stand for those of the target.
    step = torch.cat([yy * bx - xy * by, xx * by - xy * bx], dim=1) / determinant
    return step.clamp(-1, 1)


def _window(values: Tensor, side: int) -> Tensor:
    return F.avg_pool2d(F.pad(values, (side // 2,) * 4, mode="replicate"), side, stride=1)


def _resize(flow: Tensor, size: tuple[int, int]) -> Tensor:
    height, width = flow.shape[-2:]
    if size == (height, width):
        return flow
    scale = flow.new_tensor([size[1] / width, size[0] / height]).view(1, 2, 1, 1)
    return F.interpolate(flow, size=size, mode="bilinear", align_corners=False) * scale
