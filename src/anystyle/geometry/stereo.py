"""Depth of posed photographs by plane-sweep stereo with semi-global aggregation.

Every view is compared with its neighbours on planes of equal inverse depth (Collins 1996) by the zero-mean normalised
cross-correlation of small windows; costs are aggregated along rows and columns (Hirschmüller 2008); a depth is
supported by the neighbours whose own depth agrees with it.
"""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.geometry import stereo_kernels
from anystyle.types import Cameras, Value

logger = logging.getLogger(__name__)

NEAR, FAR = (0.01, 0.7), (0.98, 2.5)
"""The quantile of a view's known depths, and the factor on it, that the first and the last plane lie at."""

COARSE_SIDE, COARSE_PLANES = 112, 128
"""Short side in pixels, and planes, of the sweep that finds out how deep a scene is."""

MIN_POINTS = 32
"""A view with fewer known points searches the depths of all views together."""


@dataclass(frozen=True)
class StereoOptions:
    """How :func:`plane_sweep` searches.

    Args:
        num_planes: Planes of inverse depth.
        num_neighbors: Views that each view is compared with.
        angle: Preferred angle in degrees between the rays of two neighbours.
        radius: Windows have a side of ``2 radius + 1`` pixels.
        small_penalty: Of a step to the next plane between two pixels, in units of 1 - ZNCC.
        large_penalty: Of any other step between two pixels of the same grey value.
        tolerance: Relative difference up to which two depths agree.
    """

    num_planes: int = 64
    num_neighbors: int = 4
    angle: float = 6.0
    radius: int = 3
    small_penalty: float = 0.05
    large_penalty: float = 0.6
    tolerance: float = 0.03


@dataclass(frozen=True)
class StereoDepth(Value):
    """What stereo knows of every pixel.

    Args:
        depth: Distance along the camera's z axis, above 0 everywhere.
        confidence: Mean correlation of the better half of the neighbours at that depth, in [0, 1].
        support: How many neighbours have a depth that agrees.
    """

    depth: Float[Tensor, "V H W"]
    confidence: Float[Tensor, "V H W"]
    support: Int[Tensor, "V H W"]


def plane_sweep(
    images: Float[Tensor, "V 3 H W"],
    cameras: Cameras,
    *,
    points: Sequence[Float[Tensor, "_ 3"]] | None = None,
    options: StereoOptions | None = None,
) -> StereoDepth:
    """Estimate the depth of every view of one scene.

    Args:
        images: sRGB in [0, 1].
        cameras: A batch of one scene, for images of this size.
        points: For each view, points in world space that it shows, such as those of structure from motion: they say
            how deep the search goes and which views share what they show. Without them a coarse sweep finds out, from
            infinity to where the parallax between neighbours is the image's width.
        options: How to search.

    Raises:
        ValueError: There are fewer than two views, images and cameras do not belong together, images are smaller than
            a window, or no depth agrees between views.
    """
    options = options or StereoOptions()
    num_views, height, width = images.shape[0], images.shape[-2], images.shape[-1]
    if cameras.world_from_camera.shape[:2] != (1, num_views) or cameras.size != (height, width):
        raise ValueError(
            f"stereo got {num_views} images of {height}x{width} and cameras "
            f"{tuple(cameras.world_from_camera.shape[:2])} for "
            f"{cameras.size[0]}x{cameras.size[1]}; give the cameras of one scene, resized to the images"
        )
    if num_views < 2 or min(height, width) <= 2 * options.radius:
        raise ValueError(
            f"stereo got {num_views} images of {height}x{width}; it needs two or more, larger than a window of "
            f"{2 * options.radius + 1} pixels"
        )
    gray = (images * images.new_tensor([0.299, 0.587, 0.114])[:, None, None]).sum(1)  # V H W
    rig = _Rig(cameras.intrinsics[0].double(), cameras.camera_from_world[0].double())
    if points is None:
        points = _coarse_points(gray, rig, options)
    return _sweep(gray, rig, _ranges(rig, points), _neighbors(rig, points, cameras.size, options), options)


@dataclass(frozen=True)
class _Rig:
    """Pinhole cameras in double precision."""

    intrinsics: Float[Tensor, "V 3 3"]
    camera_from_world: Float[Tensor, "V 4 4"]

    @property
    def centers(self) -> Float[Tensor, "V 3"]:
        rotation, translation = self.camera_from_world[:, :3, :3], self.camera_from_world[:, :3, 3]
        return -(rotation.mT @ translation[..., None])[..., 0]

    def project(self, view: int, points: Float[Tensor, "P 3"]) -> tuple[Float[Tensor, "P 2"], Float[Tensor, " P"]]:
        """Pixels and depths of points in world space; a pixel means nothing where the depth is not above 0."""
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
        raise ValueError("stereo was given no point in front of a camera; leave points out to search for them")
    rows = []
    for depth in depths:
        known = depth if len(depth) >= MIN_POINTS else pooled
        rows.append(torch.stack([known.quantile(quantile) * factor for quantile, factor in (NEAR, FAR)]))
    return torch.stack(rows)


def _neighbors(rig: _Rig, points: Sequence[Tensor], size: tuple[int, int], options: StereoOptions) -> list[list[int]]:
    """For each view, those that together show its points, each point under about the preferred angle.

    They are chosen greedily: a point counts the less the more of the chosen views show it already, so that one view
    at least sees what lies at the border of the image.
    """
    height, width = size
    centers, result = rig.centers, []
    for view, shown in enumerate(points):
        away, weights = shown.double() - centers[view], []
        for other in range(len(centers)):
            pixel, depth = rig.project(other, shown)
            inside = (depth > 0) & (pixel >= 0).all(1) & (pixel <= pixel.new_tensor([width, height])).all(1)
            cosine = torch.cosine_similarity(away, shown.double() - centers[other], dim=-1)
            angle = torch.rad2deg(cosine.clamp(-1, 1).acos())
            spread = torch.where(angle < options.angle, 0.5 * options.angle, 1.3 * options.angle)
            weight = (-0.5 * ((angle - options.angle) / spread).square()).exp()
            weights.append(weight * inside * (other != view))
        weight, seen, best = torch.stack(weights), torch.zeros(len(shown), dtype=torch.float64), []
        for _ in range(options.num_neighbors):
            gain = (weight / (1 + 2 * seen)).sum(1)
            gain[best] = 0
            if not (gain > 0).any():
                break
            best.append(int(gain.argmax()))
            seen += weight[best[-1]]
        result.append(best or _nearest(rig, view, options.num_neighbors))
    return result


def _nearest(rig: _Rig, view: int, number: int) -> list[int]:
    """The views nearest to a view, of those that look the same way where there are any."""
    centers, axes = rig.centers, rig.camera_from_world[:, 2, :3]
    distance = (centers - centers[view]).norm(dim=-1)
    away = axes @ axes[view] < 0.5
    order = torch.argsort(distance + away * (1 + distance.max()))
    return [int(other) for other in order if other != view][:number]


def _coarse_points(gray: Float[Tensor, "V H W"], rig: _Rig, options: StereoOptions) -> list[Tensor]:
    """Points of each view by a sweep of small images, from infinity to where the parallax is the image's width."""
    scale = min(1.0, COARSE_SIDE / min(gray.shape[-2:]))
    size = round(gray.shape[-2] * scale), round(gray.shape[-1] * scale)
    small = interpolate(gray[None], size=size, mode="area")[0]
    factor = rig.intrinsics.new_tensor([size[1] / gray.shape[-1], size[0] / gray.shape[-2], 1.0])
    coarse = replace(rig, intrinsics=rig.intrinsics * factor[:, None])
    neighbors = [_nearest(coarse, view, options.num_neighbors) for view in range(len(gray))]
    baseline = torch.stack([(coarse.centers[others] - coarse.centers[view]).norm(dim=-1).mean()
                            for view, others in enumerate(neighbors)])  # fmt: skip
    if not (baseline > 0).all():
        raise ValueError("stereo got cameras that all stand at one point: there is no parallax to see depth by")
    near = baseline * coarse.intrinsics[:, 0, 0] / size[1]
    ranges = torch.stack([near, torch.full_like(near, float("inf"))], dim=1)
    depth = _sweep(small, coarse, ranges, neighbors, replace(options, num_planes=COARSE_PLANES, tolerance=0.05))
    # A depth at infinity says only that it is far; the last plane before infinity is as far as can be told.
    sure = (depth.support >= 1) & (depth.confidence > 0.5) & (depth.depth < 0.5 * COARSE_PLANES * near[:, None, None])
    logger.info("coarse stereo: %.0f%% of the pixels agree between views", 100 * float(sure.double().mean()))
    if int(sure.sum()) < MIN_POINTS:
        raise ValueError(
            "no depth agrees between the photographs: the cameras are wrong, what they show moves, or it has no texture"
        )
    return [coarse.unproject(view, depth.depth[view])[sure[view]] for view in range(len(gray))]


def _sweep(
    gray: Float[Tensor, "V H W"],
    rig: _Rig,
    ranges: Float[Tensor, "V 2"],
    neighbors: list[list[int]],
    options: StereoOptions,
) -> StereoDepth:
    pixels = gray.float().contiguous().numpy()
    depth, confidence = np.empty_like(pixels), np.empty_like(pixels)
    steps = torch.linspace(0, 1, options.num_planes, dtype=torch.float64)

    def estimate(view: int) -> None:
        near, far = ranges[view]
        inverse = 1 / far + (1 / near - 1 / far) * steps
        costs = np.empty((*pixels.shape[1:], options.num_planes), np.float32)
        homographies = torch.stack([_homographies(rig, view, other, inverse) for other in neighbors[view]]).numpy()
        stereo_kernels.sweep(pixels[view], pixels[neighbors[view]], homographies, options.radius, costs)
        sums = np.empty_like(costs)
        penalties = np.float32(options.small_penalty), np.float32(options.large_penalty)
        stereo_kernels.aggregate(costs, pixels[view], *penalties, sums)
        stereo_kernels.best_planes(costs, sums, depth[view], confidence[view])
        plane = depth[view].astype(np.float64)
        # The plane at infinity has a depth that can be multiplied.
        depth[view] = 1 / np.maximum(float(inverse[0]) + plane * float(inverse[1] - inverse[0]), 1e-6 / float(near))

    _each(estimate, len(gray))
    depths = torch.from_numpy(depth)
    support = torch.zeros(gray.shape, dtype=torch.int32)

    def check(view: int) -> None:
        points = rig.unproject(view, depths[view]).flatten(0, 1)
        for other in neighbors[view]:
            support[view] += _agrees(rig, points, other, depths[other], options.tolerance).view(support.shape[1:])

    _each(check, len(gray))
    return StereoDepth(depths, torch.from_numpy(confidence), support)


def _each(job: Callable[[int], None], number: int) -> None:
    """Run a job a view on as many threads as PyTorch uses."""
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        for _ in pool.map(job, range(number)):
            pass


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
