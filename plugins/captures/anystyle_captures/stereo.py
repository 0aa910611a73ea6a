"""Depth of posed photographs by plane-sweep stereo with semi-global aggregation.

Every view is compared with its neighbours on planes of equal inverse depth (Collins 1996) by the zero-mean normalised
cross-correlation of small windows; costs are aggregated along rows and columns (Hirschmüller 2008); a depth is
supported by the neighbours whose own depth agrees with it.
"""

import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import nan

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.errors import UserError
from anystyle.geometry.warp import pixels
from anystyle.types import Cameras, Value
from anystyle_captures.pixels import pixels_of
from anystyle_captures.stereo_kernels import SIDE, aggregate, best_planes, sweep
from anystyle_captures.twins import same_place

logger = logging.getLogger(__name__)
NUM_PLANES, NUM_NEIGHBORS = 64, 4
"""Planes of inverse depth, and views that each view is compared with."""
ANGLE = 6.0
"""Preferred angle in degrees between the rays of two neighbours."""
SMALL_PENALTY, LARGE_PENALTY = np.float32(0.05), np.float32(0.6)
"""Costs, in units of 1 - ZNCC, of a step to the next plane and of any other one between pixels of equal grey value."""
TOLERANCE, COARSE_TOLERANCE = 0.03, 0.05
"""Relative difference up to which two depths agree."""
NEAR, FAR = (0.01, 0.7), (0.98, 2.5)
"""The quantile of a view's known depths, and the factor on it, at which the first and the last plane lie."""
COARSE_SIDE, NEAR_SIDE, COARSE_PLANES = 112, 80, 128
"""Short sides in pixels, and planes, of the sweep that finds the range of depths, or only where it begins."""
MASKED = 0.5
"""The grey value of masked pixels."""
MIN_POINTS = 32
"""A view with fewer known points searches the depths of all views together."""


@dataclass(frozen=True)
class StereoDepth(Value):
    """The depth of every pixel: not a number where a photograph is masked, infinite in the sky.

    Args:
        depth: Along the axis of the camera.
        confidence: Correlation of the windows at this depth.
        support: The number of other views that have a surface there.
        at_infinity: Correlation of the windows at infinity.
    """

    depth: Float[Tensor, "V H W"]
    confidence: Float[Tensor, "V H W"]
    support: Int[Tensor, "V H W"]
    at_infinity: Float[Tensor, "V H W"]


def plane_sweep(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    *,
    points: Sequence[Float[Tensor, "_ 3"]] | None = None,
    valid: Bool[Tensor, "V H W"] | None = None,
) -> StereoDepth:
    """Estimate the depth of every view of one scene, without the pixels that are not valid."""
    num_views, height, width = images.shape[0], images.shape[-2], images.shape[-1]
    if num_views < 2 or min(height, width) < SIDE:
        raise UserError(
            f"stereo got {num_views} images of {height}x{width}; it needs two or more, of at least {SIDE} pixels a side"
        )
    gray = (images * images.new_tensor([0.299, 0.587, 0.114])[:, None, None]).sum(1)  # V H W
    if valid is None:
        valid = torch.ones_like(gray, dtype=torch.bool)
    else:  # windows of one grey value correlate with nothing
        gray = torch.where(valid, gray, MASKED)
    cameras = cameras.map(Tensor.double)
    if points is None:
        points = _coarse_points(gray, cameras, valid, COARSE_SIDE)
        ranges = _ranges(cameras, points)
    else:
        ranges = _with_what_is_near(_ranges(cameras, points), gray, cameras, valid)
    return _sweep(gray, cameras, ranges, _neighbors(cameras, points), NUM_PLANES, TOLERANCE, valid)


def _centers(cameras: Cameras) -> Float[Tensor, "V 3"]:
    return cameras.world_from_camera[0, :, :3, 3]


def _unprojected(cameras: Cameras, view: int, depth: Float[Tensor, "H W"]) -> Float[Tensor, "P 3"]:
    """Points in world space."""
    x, y = pixels(depth.double()).flatten(1) + 0.5
    rays = torch.stack([x, y, torch.ones_like(x)], -1) @ torch.linalg.inv(cameras.intrinsics[0, view]).T
    pose = cameras.world_from_camera[0, view]
    return (rays * depth.double().flatten()[:, None]) @ pose[:3, :3].T + pose[:3, 3]


def _ranges(cameras: Cameras, points: Sequence[Tensor]) -> Float[Tensor, "V 2"]:
    """Nearest and farthest depth of each view's search."""
    depths = [pixels_of(shown.double(), cameras, view).depth for view, shown in enumerate(points)]
    depths = [depth[depth > 0] for depth in depths]
    pooled = torch.cat(depths)
    if len(pooled) == 0:
        raise UserError("stereo was given no point in front of a camera; leave points out to search for them")
    known = [depth if len(depth) >= MIN_POINTS else pooled for depth in depths]
    return torch.stack([torch.stack([one.quantile(q) * factor for q, factor in (NEAR, FAR)]) for one in known])


def _with_what_is_near(
    ranges: Float[Tensor, "V 2"], gray: Float[Tensor, "V H W"], cameras: Cameras, valid: Bool[Tensor, "V H W"]
) -> Float[Tensor, "V 2"]:
    """Ranges that begin where a coarse sweep sees something: few features are on what is plain and near."""
    try:
        nearest = _ranges(cameras, _coarse_points(gray, cameras, valid, NEAR_SIDE))[:, 0]
    except UserError:  # no depth agrees at this size
        return ranges
    return torch.stack([ranges[:, 0].minimum(nearest), ranges[:, 1]], dim=1)


def _neighbors(cameras: Cameras, points: Sequence[Tensor]) -> list[list[int]]:
    """For each view, greedily, those that together show its points, each under about the preferred angle."""
    centers, result, near = _centers(cameras), [], same_place(cameras)
    for view, shown in enumerate(points):
        away, weights = shown.double() - centers[view], []
        for other in range(len(centers)):
            cosine = torch.cosine_similarity(away, shown.double() - centers[other], dim=-1)
            angle = torch.rad2deg(cosine.clamp(-1, 1).acos())
            spread = torch.where(angle < ANGLE, 0.5 * ANGLE, 1.3 * ANGLE)
            apart = bool((centers[other] - centers[view]).norm() > near)
            inside = pixels_of(shown.double(), cameras, other).within
            weights.append((-0.5 * ((angle - ANGLE) / spread).square()).exp() * inside * apart)
        weight, seen, best = torch.stack(weights), torch.zeros(len(shown), dtype=torch.float64), []
        for _ in range(NUM_NEIGHBORS):
            gain = (weight / (1 + 2 * seen)).sum(1)
            gain[best] = 0
            if not (gain > 0).any():
                break
            best.append(int(gain.argmax()))
            seen += weight[best[-1]]
        result.append(best or _nearest(cameras, view))
    return result


def _nearest(cameras: Cameras, view: int) -> list[int]:
    """The views nearest to a view, preferring similar viewing directions."""
    centers, axes, near = _centers(cameras), cameras.world_from_camera[0, :, :3, 2], same_place(cameras)
    distance = (centers - centers[view]).norm(dim=-1)
    away = axes @ axes[view] < 0.5
    order = torch.argsort(distance + away * (1 + distance.max()))
    return [int(other) for other in order if distance[other] > near][:NUM_NEIGHBORS]


def _coarse_points(
    gray: Float[Tensor, "V H W"], cameras: Cameras, valid: Bool[Tensor, "V H W"], side: int
) -> list[Tensor]:
    """Points of each view by a sweep of small images, from infinity to where the parallax is the image's width."""
    scale = min(1.0, side / min(gray.shape[-2:]))
    size = round(gray.shape[-2] * scale), round(gray.shape[-1] * scale)
    small = interpolate(gray[None], size=size, mode="area")[0]
    inside = interpolate(valid[None].float(), size=size, mode="area")[0] == 1
    coarse = cameras.resized(size)
    neighbors, centers = [_nearest(coarse, view) for view in range(len(gray))], _centers(coarse)
    baseline = torch.stack([(centers[others] - centers[view]).norm(dim=-1).mean()
                            for view, others in enumerate(neighbors)])  # fmt: skip
    if not (baseline > 0).all():
        raise UserError("stereo got cameras that all stand at one point: there is no parallax to see depth by")
    near = baseline * coarse.intrinsics[0, :, 0, 0] / size[1]
    ranges = torch.stack([near, torch.full_like(near, float("inf"))], dim=1)
    depth = _sweep(small, coarse, ranges, neighbors, COARSE_PLANES, COARSE_TOLERANCE, inside)
    # Beyond the last planes before infinity depths cannot be distinguished.
    sure = (depth.support >= 1) & (depth.confidence > 0.5) & (depth.depth < 0.5 * COARSE_PLANES * near[:, None, None])
    logger.info("coarse stereo: %.0f%% of the pixels agree between views", 100 * float(sure.double().mean()))
    if int(sure.sum()) < MIN_POINTS:
        raise UserError(
            "no depth agrees between the photographs: the cameras are wrong, what they show moves, or it has no texture"
        )
    return [_unprojected(coarse, view, depth.depth[view])[sure[view].flatten()] for view in range(len(gray))]


def _sweep(
    gray: Float[Tensor, "V H W"],
    cameras: Cameras,
    ranges: Float[Tensor, "V 2"],
    neighbors: list[list[int]],
    num_planes: int,
    tolerance: float,
    valid: Bool[Tensor, "V H W"],
) -> StereoDepth:
    given = gray.float().contiguous().numpy()
    depth, confidence, infinite = (np.empty_like(given) for _ in range(3))
    steps = torch.linspace(0, 1, num_planes, dtype=torch.float64)

    def estimate(view: int) -> None:
        near, far = ranges[view]
        inverse = 1 / far + (1 / near - 1 / far) * steps
        costs, last = (np.empty((*given.shape[1:], planes), np.float32) for planes in (num_planes, 1))
        homographies, beyond = (
            torch.stack([_homographies(cameras, view, other, planes) for other in neighbors[view]]).numpy()
            for planes in (inverse, torch.zeros_like(inverse[:1]))
        )
        mean, square = (uniform_filter(values, SIDE, mode="nearest") for values in (given[view], given[view] ** 2))
        windows = given[view], mean, np.maximum(square - mean**2, 0), given[neighbors[view]]
        sweep(*windows, homographies, costs)
        sweep(*windows, beyond, last)
        infinite[view] = 1 - last[..., 0]
        sums = np.empty_like(costs)
        aggregate(costs, given[view], SMALL_PENALTY, LARGE_PENALTY, sums)
        best_planes(costs, sums, depth[view], confidence[view])
        plane = depth[view].astype(np.float64)
        # The depth of the plane at infinity stays finite.
        depth[view] = 1 / np.maximum(float(inverse[0]) + plane * float(inverse[1] - inverse[0]), 1e-6 / float(near))

    depths = torch.from_numpy(depth)  # the same memory
    support = torch.zeros(gray.shape, dtype=torch.int32)

    def check(view: int) -> None:
        points = _unprojected(cameras, view, depths[view])
        for other in neighbors[view]:
            support[view] += _agrees(cameras, points, other, depths[other], tolerance).view(support.shape[1:])

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        list(pool.map(estimate, range(len(gray))))
        depths[~valid] = nan  # agrees with nothing
        list(pool.map(check, range(len(gray))))
    return StereoDepth(depths, torch.from_numpy(confidence), support, torch.from_numpy(infinite))


def _homographies(cameras: Cameras, view: int, other: int, inverse: Float[Tensor, " D"]) -> Float[Tensor, "D 3 3"]:
    """From pixels of ``view`` to those of ``other`` through planes parallel to the image of ``view``."""
    motion = cameras.camera_from_world[0, other] @ cameras.world_from_camera[0, view]
    plane = motion[:3, :3].expand(len(inverse), 3, 3).clone()
    plane[:, :, 2] += inverse[:, None] * motion[:3, 3]
    return cameras.intrinsics[0, other] @ plane @ torch.linalg.inv(cameras.intrinsics[0, view])


def _agrees(
    cameras: Cameras, points: Float[Tensor, "P 3"], other: int, depth: Float[Tensor, "H W"], tolerance: float
) -> Tensor:
    """Whether another view has its surface where points in world space are."""
    found = pixels_of(points, cameras, other)
    return found.within & ((depth[found.row, found.column] / found.depth - 1).abs() < tolerance)
