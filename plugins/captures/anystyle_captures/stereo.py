"""Depth of posed photographs by plane-sweep stereo with semi-global aggregation.

Every view is compared with its neighbours on planes of equal inverse depth (Collins 1996) by the zero-mean normalised
cross-correlation of small windows; costs are aggregated along rows and columns (Hirschmüller 2008); a depth is
supported by the neighbours whose own depth agrees with it.
"""

import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import nan

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.errors import UserError
from anystyle.types import Cameras, Value
from anystyle_captures.stereo_kernels import aggregate, best_planes, sweep
from anystyle_captures.twins import SAME_PLACE

logger = logging.getLogger(__name__)
NUM_PLANES, NUM_NEIGHBORS = 64, 4
"""Planes of inverse depth, and views that each view is compared with."""
ANGLE = 6.0
"""Preferred angle in degrees between the rays of two neighbours."""
RADIUS = 3
"""Windows have a side of ``2 RADIUS + 1`` pixels."""
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
    if num_views < 2 or min(height, width) <= 2 * RADIUS:
        raise UserError(
            f"stereo got {num_views} images of {height}x{width}; it needs two or more, larger than a window of "
            f"{2 * RADIUS + 1} pixels"
        )
    gray = (images * images.new_tensor([0.299, 0.587, 0.114])[:, None, None]).sum(1)  # V H W
    if valid is None:
        valid = torch.ones_like(gray, dtype=torch.bool)
    else:  # windows of one grey value correlate with nothing
        gray = torch.where(valid, gray, MASKED)
    rig = _Rig(cameras.intrinsics[0].double(), cameras.camera_from_world[0].double())
    if points is None:
        points = _coarse_points(gray, rig, valid, COARSE_SIDE)
        ranges = _ranges(rig, points)
    else:
        ranges = _with_what_is_near(_ranges(rig, points), gray, rig, valid)
    neighbors = _neighbors(rig, points, cameras.size)
    return _sweep(gray, rig, ranges, neighbors, NUM_PLANES, TOLERANCE, valid)


@dataclass(frozen=True)
class _Rig:
    """Pinhole cameras in double precision."""

    intrinsics: Float[Tensor, "V 3 3"]
    camera_from_world: Float[Tensor, "V 4 4"]

    @property
    def centers(self) -> Float[Tensor, "V 3"]:
        rotation, translation = self.camera_from_world[:, :3, :3], self.camera_from_world[:, :3, 3]
        return -(rotation.mT @ translation[..., None])[..., 0]

    @property
    def same_place(self) -> float:
        """Distance up to which cameras show no parallax, as the views of a panorama."""
        return SAME_PLACE * float((self.centers - self.centers.mean(0)).norm(dim=1).amax())

    def project(self, view: int, points: Float[Tensor, "P 3"]) -> tuple[Float[Tensor, "P 2"], Float[Tensor, " P"]]:
        """Pixels and depths of points in world space; a pixel is only valid where the depth is above 0."""
        motion = self.camera_from_world[view]
        local = points.double() @ motion[:3, :3].T + motion[:3, 3]
        image = local @ self.intrinsics[view].T
        return image[:, :2] / image[:, 2:].clamp_min(1e-12), local[:, 2]

    def unproject(self, view: int, depth: Float[Tensor, "H W"]) -> Float[Tensor, "H W 3"]:
        """Points in world space."""
        y = torch.arange(depth.shape[0], dtype=torch.float64) + 0.5
        x = torch.arange(depth.shape[1], dtype=torch.float64) + 0.5
        y, x = torch.meshgrid(y, x, indexing="ij")
        rays = torch.stack([x, y, torch.ones_like(x)], -1) @ torch.linalg.inv(self.intrinsics[view]).T
        motion = self.camera_from_world[view]
        return (rays * depth.double()[..., None] - motion[:3, 3]) @ motion[:3, :3]


def _ranges(rig: _Rig, points: Sequence[Tensor]) -> Float[Tensor, "V 2"]:
    """Nearest and farthest depth of each view's search."""
    depths = [rig.project(view, shown)[1] for view, shown in enumerate(points)]
    depths = [depth[depth > 0] for depth in depths]
    pooled = torch.cat(depths)
    if len(pooled) == 0:
        raise UserError("stereo was given no point in front of a camera; leave points out to search for them")
    known = [depth if len(depth) >= MIN_POINTS else pooled for depth in depths]
    return torch.stack([torch.stack([one.quantile(q) * factor for q, factor in (NEAR, FAR)]) for one in known])


def _with_what_is_near(
    ranges: Float[Tensor, "V 2"], gray: Float[Tensor, "V H W"], rig: _Rig, valid: Bool[Tensor, "V H W"]
) -> Float[Tensor, "V 2"]:
    """Ranges that begin where a coarse sweep sees something: few features are on what is plain and near."""
    try:
        nearest = _ranges(rig, _coarse_points(gray, rig, valid, NEAR_SIDE))[:, 0]
    except UserError:  # no depth agrees at this size
        return ranges
    return torch.stack([ranges[:, 0].minimum(nearest), ranges[:, 1]], dim=1)


def _neighbors(rig: _Rig, points: Sequence[Tensor], size: tuple[int, int]) -> list[list[int]]:
    """For each view, greedily, those that together show its points, each under about the preferred angle."""
    height, width = size
    centers, result, near = rig.centers, [], rig.same_place
    for view, shown in enumerate(points):
        away, weights = shown.double() - centers[view], []
        for other in range(len(centers)):
            pixel, depth = rig.project(other, shown)
            inside = (depth > 0) & (pixel >= 0).all(1) & (pixel <= pixel.new_tensor([width, height])).all(1)
            cosine = torch.cosine_similarity(away, shown.double() - centers[other], dim=-1)
            angle = torch.rad2deg(cosine.clamp(-1, 1).acos())
            spread = torch.where(angle < ANGLE, 0.5 * ANGLE, 1.3 * ANGLE)
            apart = bool((centers[other] - centers[view]).norm() > near)
            weights.append((-0.5 * ((angle - ANGLE) / spread).square()).exp() * inside * apart)
        weight, seen, best = torch.stack(weights), torch.zeros(len(shown), dtype=torch.float64), []
        for _ in range(NUM_NEIGHBORS):
            gain = (weight / (1 + 2 * seen)).sum(1)
            gain[best] = 0
            if not (gain > 0).any():
                break
            best.append(int(gain.argmax()))
            seen += weight[best[-1]]
        result.append(best or _nearest(rig, view))
    return result


def _nearest(rig: _Rig, view: int) -> list[int]:
    """The views nearest to a view, preferring similar viewing directions."""
    centers, axes = rig.centers, rig.camera_from_world[:, 2, :3]
    distance = (centers - centers[view]).norm(dim=-1)
    away = axes @ axes[view] < 0.5
    order = torch.argsort(distance + away * (1 + distance.max()))
    return [int(other) for other in order if distance[other] > rig.same_place][:NUM_NEIGHBORS]


def _coarse_points(gray: Float[Tensor, "V H W"], rig: _Rig, valid: Bool[Tensor, "V H W"], side: int) -> list[Tensor]:
    """Points of each view by a sweep of small images, from infinity to where the parallax is the image's width."""
    scale = min(1.0, side / min(gray.shape[-2:]))
    size = round(gray.shape[-2] * scale), round(gray.shape[-1] * scale)
    small = interpolate(gray[None], size=size, mode="area")[0]
    inside = interpolate(valid[None].float(), size=size, mode="area")[0] == 1
    factor = rig.intrinsics.new_tensor([size[1] / gray.shape[-1], size[0] / gray.shape[-2], 1.0])
    coarse = replace(rig, intrinsics=rig.intrinsics * factor[:, None])
    neighbors = [_nearest(coarse, view) for view in range(len(gray))]
    baseline = torch.stack([(coarse.centers[others] - coarse.centers[view]).norm(dim=-1).mean()
                            for view, others in enumerate(neighbors)])  # fmt: skip
    if not (baseline > 0).all():
        raise UserError("stereo got cameras that all stand at one point: there is no parallax to see depth by")
    near = baseline * coarse.intrinsics[:, 0, 0] / size[1]
    ranges = torch.stack([near, torch.full_like(near, float("inf"))], dim=1)
    depth = _sweep(small, coarse, ranges, neighbors, COARSE_PLANES, COARSE_TOLERANCE, inside)
    # Beyond the last planes before infinity depths cannot be distinguished.
    sure = (depth.support >= 1) & (depth.confidence > 0.5) & (depth.depth < 0.5 * COARSE_PLANES * near[:, None, None])
    logger.info("coarse stereo: %.0f%% of the pixels agree between views", 100 * float(sure.double().mean()))
    if int(sure.sum()) < MIN_POINTS:
        raise UserError(
            "no depth agrees between the photographs: the cameras are wrong, what they show moves, or it has no texture"
        )
    return [coarse.unproject(view, depth.depth[view])[sure[view]] for view in range(len(gray))]


def _sweep(
    gray: Float[Tensor, "V H W"],
    rig: _Rig,
    ranges: Float[Tensor, "V 2"],
    neighbors: list[list[int]],
    num_planes: int,
    tolerance: float,
    valid: Bool[Tensor, "V H W"],
) -> StereoDepth:
    pixels = gray.float().contiguous().numpy()
    depth, confidence, infinite = (np.empty_like(pixels) for _ in range(3))
    steps = torch.linspace(0, 1, num_planes, dtype=torch.float64)

    def estimate(view: int) -> None:
        near, far = ranges[view]
        inverse = 1 / far + (1 / near - 1 / far) * steps
        costs, last = (np.empty((*pixels.shape[1:], planes), np.float32) for planes in (num_planes, 1))
        homographies, beyond = (
            torch.stack([_homographies(rig, view, other, planes) for other in neighbors[view]]).numpy()
            for planes in (inverse, torch.zeros_like(inverse[:1]))
        )
        sweep(pixels[view], pixels[neighbors[view]], homographies, RADIUS, costs)
        sweep(pixels[view], pixels[neighbors[view]], beyond, RADIUS, last)
        infinite[view] = 1 - last[..., 0]
        sums = np.empty_like(costs)
        aggregate(costs, pixels[view], SMALL_PENALTY, LARGE_PENALTY, sums)
        best_planes(costs, sums, depth[view], confidence[view])
        plane = depth[view].astype(np.float64)
        # The depth of the plane at infinity stays finite.
        depth[view] = 1 / np.maximum(float(inverse[0]) + plane * float(inverse[1] - inverse[0]), 1e-6 / float(near))

    depths = torch.from_numpy(depth)  # the same memory
    support = torch.zeros(gray.shape, dtype=torch.int32)

    def check(view: int) -> None:
        points = rig.unproject(view, depths[view]).flatten(0, 1)
        for other in neighbors[view]:
            support[view] += _agrees(rig, points, other, depths[other], tolerance).view(support.shape[1:])

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        list(pool.map(estimate, range(len(gray))))
        depths[~valid] = nan  # agrees with nothing
        list(pool.map(check, range(len(gray))))
    return StereoDepth(depths, torch.from_numpy(confidence), support, torch.from_numpy(infinite))


def _homographies(rig: _Rig, view: int, other: int, inverse: Float[Tensor, " D"]) -> Float[Tensor, "D 3 3"]:
    """From pixels of ``view`` to those of ``other`` through planes parallel to the image of ``view``."""
    motion = rig.camera_from_world[other] @ torch.linalg.inv(rig.camera_from_world[view])
    plane = motion[:3, :3].expand(len(inverse), 3, 3).clone()
    plane[:, :, 2] += inverse[:, None] * motion[:3, 3]
    return rig.intrinsics[other] @ plane @ torch.linalg.inv(rig.intrinsics[view])


def _agrees(
    rig: _Rig, points: Float[Tensor, "P 3"], other: int, depth: Float[Tensor, "H W"], tolerance: float
) -> Tensor:
    """Whether another view has its surface where points in world space are."""
    height, width = depth.shape
    pixel, distance = rig.project(other, points)
    column, row = pixel.floor().long().unbind(1)
    inside = (distance > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    nearest = depth[row.clamp(0, height - 1), column.clamp(0, width - 1)]
    return inside & ((nearest / distance - 1).abs() < tolerance)
