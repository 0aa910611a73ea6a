"""The sky: plain or without parallax, bright, above the horizon, up to the upper border of photographs."""

from dataclasses import replace
from math import inf, radians, sin

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_fill_holes, label
from torch import Tensor
from torch.nn.functional import avg_pool2d

from anystyle.geometry.warp import pixels
from anystyle.types import Cameras
from anystyle_captures.stereo import StereoDepth
from anystyle_captures.stereo_kernels import RADIUS

PLAIN = 0.02
"""Standard deviation of grey values, in [0, 1], in a window of stereo below which depths are guesses."""
MATCHED = 0.5
"""Correlation of windows from which on a match at infinity counts, unless that at the depth found is higher."""
MIN_SKY = 0.05
"""The share of all photographs under which a sky is left as it is: in a strip between roofs nothing is gained."""
STRIDE, MAX_OTHERS = 4, 24
"""Pixels between those that are looked up in other views, and how many of these, evenly spaced."""
MIN_VOTES, MIN_SHARE, MIN_AREA = 2, 0.7, 0.01
"""Views that must look towards a pixel; which share of them, over a region, must find the same there; and the smallest
region, relative to the photograph."""
BELOW, MAX_BELOW = -3.0, 0.05
"""Degrees under the horizon that cameras may be off by, and the share of a region that may lie lower still."""
BRIGHTER = 0.85
"""Share of all other pixels than which a sky is brighter in its brightest channel."""
ALIKE = 0.08
"""Difference of colours, in [0, 1], up to which pixels beside the sky belong to it: windows end before outlines."""


def plain(images: Float[Tensor, "V 3 H W"]) -> Bool[Tensor, "V H W"]:
    """Where windows of stereo have too little texture for its depth to be more than a guess."""
    gray = images.mean(1, keepdim=True)
    mean, square = (_window_mean(values, RADIUS) for values in (gray, gray.square()))
    return (square - mean.square())[:, 0] < PLAIN**2


def without_sky(images: Float[Tensor, "V 3 H W"], cameras: Cameras, stereo: StereoDepth) -> StereoDepth:
    """Depths by stereo, infinite and without support in the sky of a capture that shows more than a little of it."""
    sky = find_sky(images, cameras, stereo)
    if sky.double().mean() < MIN_SKY:
        return stereo
    return replace(stereo, depth=stereo.depth.masked_fill(sky, inf), support=stereo.support.masked_fill(sky, 0))


def find_sky(images: Float[Tensor, "V 3 H W"], cameras: Cameras, stereo: StereoDepth) -> Bool[Tensor, "V H W"]:
    """Pixels of the sky in posed photographs.

    A region of pixels that are plain or match best at infinity is sky if it reaches the upper border, lies above the
    horizon, is brighter than nearly all that it may light, and if other views that look in the same directions find
    such pixels there, or a surface before them: roads and most walls have parallax, so that they find something else.
    """
    far = plain(images) | ((stereo.at_infinity > MATCHED) & (stereo.at_infinity >= stereo.confidence))
    far &= ~stereo.depth.isnan()
    agreed, sky, brightness = stereo.support >= 2, torch.zeros_like(far), images.amax(1)
    up = _up(cameras.world_from_camera[0, :, :3, :3])
    for view in range(len(far)):
        regions = np.empty(far.shape[1:], np.int32)
        label(far[view].numpy(), output=regions)
        if not regions[0].any():
            continue
        rays = _rays(cameras, view)
        low = (rays @ up) / rays.norm(dim=1) < sin(radians(BELOW))
        votes, seen = _votes(rays, view, cameras, far & ~agreed, agreed)
        sampled, loose = (
            torch.from_numpy(mask)[::STRIDE, ::STRIDE].flatten() for mask in (regions, ~agreed[view].numpy())
        )
        for region in set(regions[0].tolist()) - {0}:
            inside = sampled == region
            voted = inside & loose & (seen >= MIN_VOTES)
            if inside.double().mean() < MIN_AREA or low[inside].double().mean() > MAX_BELOW or not voted.any():
                continue
            region = torch.from_numpy(regions == region)
            darker = (brightness[view][~far[view]] <= brightness[view][region].median()).double().mean()
            if darker >= BRIGHTER and (votes[voted] / seen[voted]).mean() >= MIN_SHARE:
                sky[view] |= region
    if not sky.any():
        return sky
    # Clouds and birds.
    sky = torch.stack([torch.from_numpy(binary_fill_holes(mask.numpy())) for mask in sky])
    weight = sky[:, None].to(images)
    share = _window_mean(weight, RADIUS + 1)
    color = _window_mean(images * weight, RADIUS + 1) / share.clamp_min(1e-6)
    beside = (share[:, 0] > 1e-6) & ((images - color).abs().amax(1) < ALIKE) & ~stereo.depth.isnan()
    return sky | beside


def _rays(cameras: Cameras, view: int) -> Float[Tensor, "P 3"]:
    """Directions in world space of every :data:`STRIDE`-th pixel of every such row."""
    x, y = pixels(cameras.intrinsics.new_empty(cameras.size))[:, ::STRIDE, ::STRIDE].flatten(1) + 0.5
    local = torch.linalg.solve(cameras.intrinsics[0, view], torch.stack([x, y, torch.ones_like(x)]))
    return (cameras.world_from_camera[0, view, :3, :3] @ local).T


def _votes(
    rays: Float[Tensor, "P 3"], view: int, cameras: Cameras, far: Bool[Tensor, "V H W"], agreed: Bool[Tensor, "V H W"]
) -> tuple[Int[Tensor, " P"], Int[Tensor, " P"]]:
    """How many other views find something far in the directions of a view, and how many see whether it is."""
    others = [other for other in range(len(far)) if other != view]
    chosen = torch.tensor(others[:: -(-len(others) // MAX_OTHERS)])
    rotations, (height, width) = cameras.world_from_camera[0, chosen, :3, :3], cameras.size
    image = torch.einsum("oij,pj->opi", cameras.intrinsics[0, chosen] @ rotations.mT, rays)
    column, row = (image[..., :2] / image[..., 2:].clamp_min(1e-6)).floor().long().unbind(-1)
    within = (image[..., 2] > 0) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
    at = chosen[:, None], row.clamp(0, height - 1), column.clamp(0, width - 1)
    # A surface hides what lies behind it.
    return (within & far[at]).sum(0), (within & ~agreed[at]).sum(0)


def _window_mean(images: Float[Tensor, "V C H W"], radius: int) -> Float[Tensor, "V C H W"]:
    return avg_pool2d(images, 2 * radius + 1, 1, radius, count_include_pad=False)


def _up(rotations: Float[Tensor, "V 3 3"]) -> Float[Tensor, "3"]:
    """The direction across which photographers hold cameras level, nearest to what is upwards in the photographs."""
    right, down = rotations[..., 0].double(), rotations[..., 1].double()
    up = torch.linalg.eigh(right.T @ right - 0.1 * down.T @ down).eigenvectors[:, 0]
    return (up if float((down @ up).sum()) < 0 else -up).to(rotations)
