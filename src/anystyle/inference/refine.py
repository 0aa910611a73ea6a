"""A short alignment of cameras at test time, for any backbone: not part of the single pass, and off by default."""

from dataclasses import replace
from itertools import combinations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Adapter
from anystyle.geometry.bundle import Bundle, Tracks, adjust
from anystyle.geometry.matching import PatchMatches, describe_points, grid_points, match_points
from anystyle.nn.reference_view import in_order, reference_first
from anystyle.types import Cameras, Geometry, Scene

MIN_MATCHES = 20
"""A scene with a view that has fewer matches stays as it is."""
WORKING_SIDE = 112
"""Shorter side, in pixels, that views are compared at."""
MAX_POINTS = 4096
"""About so many points in all views together are followed; with many views, fewer in each."""
MAX_NEIGHBOURS = 6
"""Each view is compared with at most so many of those whose cameras are nearest."""
ROUNDS = ((30.0, (16.0, 8.0, 4.0, 2.0)), (8.0, (4.0, 2.0, 1.5, 1.5)))
"""For each round of matching its reach, and the steps' bounds of doubt, in pixels of the working size."""


@torch.no_grad()
def refine(scene: Scene, adapter: Adapter) -> Scene:
    """A scene with cameras, and a scale of each view's depth, that agree with what several views see alike.

    Patches of the views are matched near where the predicted geometry expects them, bundle adjustment moves cameras
    and depth to where the matches want them, and both are done once more from there. Nothing is learnt, and nothing but
    the photographs and the predicted geometry is looked at; depth is read as distance along z. Focal lengths stay, and
    so does the camera of the view that the others are seen from.

    Args:
        scene: As encoded; one view alone is returned as it is.
        adapter: Of the backbone it came from; decides anew which pixels become one Gaussian.
    """
    if scene.views.images.shape[1] < 2:
        return scene
    reference = scene.stem.reference
    first = torch.zeros(scene.batch, dtype=torch.long, device=scene.views.images.device)
    order = reference_first(first if reference is None else reference, scene.views.images.shape[1])
    images, geometry = in_order(scene.views.images, order), scene.geometry.map(lambda tensor: in_order(tensor, order))
    rows = [_refined(images[row], geometry, row) for row in range(scene.batch)]
    poses, scales = (in_order(torch.stack(parts), order.argsort(dim=1)) for parts in zip(*rows, strict=True))
    cameras = replace(scene.geometry.cameras, world_from_camera=poses)
    geometry = replace(scene.geometry, cameras=cameras, depth=scene.geometry.depth * scales[..., None, None])
    return replace(scene, geometry=geometry, clusters=adapter.cluster(geometry, scene.attributes))


def _refined(
    images: Float[Tensor, "V 3 H W"], geometry: Geometry, row: int
) -> tuple[Float[Tensor, "V 4 4"], Float[Tensor, " V"]]:
    """World from camera, and the scales of depth, of one scene of a batch."""
    height, width = images.shape[-2:]
    shrink = WORKING_SIDE / min(height, width)
    size = round(height * shrink), round(width * shrink)
    small = F.interpolate(images.float(), size=size, mode="bilinear", align_corners=False, antialias=shrink < 1)
    cameras = geometry.cameras.resized(size)
    matcher = _Matcher(small, cameras, geometry.depth[row].float(), row)
    inverse = cameras.camera_from_world[row].float()
    rotation, translation = inverse[:, :3, :3], inverse[:, :3, 3]
    log_scale = torch.zeros(len(images), dtype=inverse.dtype, device=inverse.device)
    for reach, doubtful in ROUNDS:
        tracks = matcher.tracks(rotation, translation, log_scale, reach)
        matched_views = torch.cat([tracks.view[tracks.point], tracks.target])
        if int(torch.bincount(matched_views, minlength=len(images)).min()) < MIN_MATCHES:
            return cameras.world_from_camera[row], torch.ones_like(log_scale)
        start = Bundle(rotation, translation, log_scale, tracks.log_depth + log_scale[tracks.view])
        pixel = 1 / matcher.focal
        adjusted = adjust(start, tracks, doubtful=tuple(bound * pixel for bound in doubtful), noise=pixel)
        rotation, translation, log_scale = adjusted.rotation, adjusted.translation, adjusted.log_scale
    pose = cameras.world_from_camera[row].clone()
    pose[:, :3, :3] = rotation.mT
    pose[:, :3, 3] = -torch.einsum("vji,vj->vi", rotation, translation)
    return pose, log_scale.exp()


class _Matcher:
    """Matches between the views of one scene; what does not depend on cameras is computed once."""

    def __init__(self, images: Float[Tensor, "V 3 h w"], cameras: Cameras, depth: Tensor, row: int) -> None:
        num_views, size = len(images), (images.shape[-2], images.shape[-1])
        self.size, self.columns = size, len(range(0, size[1], 2))
        self.depth = F.interpolate(depth[:, None], size=size, mode="bilinear", align_corners=False)[:, 0]
        intrinsics = cameras.intrinsics[row].float()
        self.focal_lengths, self.centre = intrinsics[:, [0, 1], [0, 1]], intrinsics[:, :2, 2]
        self.focal = float(self.focal_lengths.mean())
        stride = 4
        while num_views * len(range(0, size[0], stride)) * len(range(0, size[1], stride)) > MAX_POINTS:
            stride += 2
        self.points, self.cells = (grid_points(size, step, images.device) for step in (stride, 2))
        self.cell_descriptors = describe_points(images, 2)
        y, x = (self.points - 0.5).long().unbind(-1)[::-1]
        self.point_descriptors = self.cell_descriptors[:, y // 2 * self.columns + x // 2]
        self.pairs = _pairs(cameras.world_from_camera[row])

    def tracks(
        self,
        rotation: Float[Tensor, "V 3 3"],
        translation: Float[Tensor, "V 3"],
        log_scale: Float[Tensor, " V"],
        reach: float,
    ) -> Tracks:
        """Matches between the views, searched near where cameras of these poses and scales of depth expect them."""
        num_views, num_points = len(rotation), len(self.points)
        rays = (self.points - self.centre[:, None]) / self.focal_lengths[:, None]  # V N 2
        log_depth = self._log_depth(self.points.expand(num_views, -1, -1), torch.arange(num_views, device=rays.device))
        depth = (log_depth + log_scale[:, None]).exp()
        points = torch.cat([rays, torch.ones_like(rays[..., :1])], dim=-1) * depth[..., None]
        matches: list[tuple[int, int, PatchMatches]] = []
        for source, target in self.pairs:
            world = (points[source] - translation[source]) @ rotation[source]
            local = world @ rotation[target].mT + translation[target]
            expected = local[:, :2] / local[:, 2:].clamp_min(0.05) * self.focal_lengths[target] + self.centre[target]
            similarity = self.point_descriptors[source] @ self.cell_descriptors[target].mT
            match = match_points(similarity, self.points, self.cells, expected, num_columns=self.columns, radius=reach)
            matches.append((source, target, match))
        pixels = torch.cat([match.pixel for _, _, match in matches])
        target = torch.cat([match.source.new_full(match.source.shape, view) for _, view, match in matches])
        keys = torch.cat([match.source + view * num_points for view, _, match in matches])
        distinct, point = torch.unique(keys, return_inverse=True)
        view, index = distinct // num_points, distinct % num_points
        return Tracks(
            view=view,
            ray=rays[view, index],
            log_depth=log_depth[view, index],
            point=point,
            target=target,
            observed=(pixels - self.centre[target]) / self.focal_lengths[target],
            target_log_depth=self._log_depth(pixels[:, None], target)[:, 0],
            weight=torch.cat([match.similarity for _, _, match in matches]),
        )

    def _log_depth(self, pixels: Float[Tensor, "M P 2"], views: Tensor) -> Float[Tensor, "M P"]:
        """The logarithm of the nearest pixel's depth in each row's view."""
        column = pixels[..., 0].floor().long().clamp(0, self.size[1] - 1)
        row = pixels[..., 1].floor().long().clamp(0, self.size[0] - 1)
        return self.depth[views[:, None], row, column].clamp_min(1e-3).log()


def _pairs(world_from_camera: Float[Tensor, "V 4 4"]) -> list[tuple[int, int]]:
    """Both orders of every two views of which one is among the nearest of the other."""
    positions = world_from_camera[:, :3, 3]
    order = torch.cdist(positions[None], positions[None])[0].argsort(dim=1, stable=True)
    nearest = order[:, : MAX_NEIGHBOURS + 1].tolist()
    pairs = [(i, j) for i, j in combinations(range(len(positions)), 2) if j in nearest[i] or i in nearest[j]]
    return [*pairs, *((j, i) for i, j in pairs)]
