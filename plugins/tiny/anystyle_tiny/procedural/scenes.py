"""Rooms and gardens with exact depth, poses and intrinsics, made on the fly."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from anystyle.contracts import SceneSource
from anystyle.errors import UserError
from anystyle.io.cache import LRUCache
from anystyle.ranges import AtLeastOne, Count
from anystyle.types import Cameras, Views
from anystyle_tiny.procedural.layout import SPLITS, Draw, ImageSide, World, lay_out, unit_circle
from anystyle_tiny.procedural.raycast import EXTENT, ROOM, cast
from anystyle_tiny.procedural.solids import SOLIDS
from anystyle_tiny.procedural.volumes import volumes

Float64Array = NDArray[np.float64]

# Rejection looks at small square previews: what a scene is does not depend on the size it is rendered at.
PREVIEW = 24
ATTEMPTS = 60
# Linear light of the mean pixel before the film's curve.
EXPOSED = 0.36
# From y up in the ray caster to OpenCV's y down in the world that is handed out.
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


class Shot(NamedTuple):
    """A scene that passed the inspection, with what rendering needs.

    ``poses`` are world from camera in metres, y up; ``focal`` is in units of the shorter side, ``unit`` the metres in a
    unit of the scene that is handed out.
    """

    world: World
    poses: Float64Array
    focal: float
    unit: float
    exposure: float


class ProceduralScenes(SceneSource):
    """Scenes of solids with photograph-like textures, light and shadow, each made when it is read.

    A camera moves on an arc of 10 to 50 degrees around rooms or gardens; a scene is drawn again if something near fills
    a view, if a view is nearly empty, or if the views overlap too little. The sky is a dome at a finite
    distance, so that every pixel has a depth. The mean depth of the first view is about 1. Images are rounded to
    8 bits, as photographs are.

    Args:
        size: Height in pixels, and width unless that is given; ``None`` is the backbone's resolution.
        width: Width in pixels.
        num_scenes: How many scenes.
        views: Views per scene.
        seed: Seed of the world; the splits of one seed share no scene.
        split: Which scenes.
        samples: Rays per pixel's side; their square is cast for a pixel.
    """

    def __init__(
        self,
        *,
        size: ImageSide | None = None,
        width: ImageSide | None = None,
        num_scenes: AtLeastOne = 10000,
        views: AtLeastOne = 6,
        seed: Count = 0,
        split: Literal["train", "validation", "heldout"] = "train",
        samples: AtLeastOne = 2,
        resolution: int = 112,
    ) -> None:
        size = resolution if size is None else size
        self.size, self.num_scenes, self.views, self.samples = (size, width or size), num_scenes, views, samples
        self.seed, self.split = seed, split
        self._shots: LRUCache[int, Shot] = LRUCache(4)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"size": 32, "num_scenes": 4, "views": 3}

    def __len__(self) -> int:
        return self.num_scenes

    def name(self, scene: int) -> str:
        """The split, the seed and the number."""
        self._check(scene)
        return f"{self.split}-{self.seed}-{scene:05d}"

    def num_views(self, scene: int) -> int:
        self._check(scene)
        return self.views

    def read(self, scene: int, views: Sequence[int]) -> Views:
        self._check(scene)
        views = list(views)
        wrong = [view for view in views if not 0 <= view < self.views]
        if wrong or not views:
            raise UserError(f"views {views} of a scene of {self.views}: give at least one of 0 to {self.views - 1}")
        shot = self._shots.get(scene, lambda: self._find(scene))
        height, width = self.size
        focal = shot.focal * min(self.size)
        casts = [_cast(shot.world, shot.poses[view], focal, self.size, self.samples) for view in views]
        poses = FLIP @ shot.poses[views]
        poses[:, :3, 3] /= shot.unit
        levels = torch.from_numpy(_develop(np.stack([one.color for one in casts]), shot.exposure)).permute(0, 3, 1, 2)
        intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        lenses = intrinsics.expand(1, len(views), 3, 3).contiguous()
        return Views(
            images=(levels.float() / 255.0)[None].contiguous(),
            cameras=Cameras(torch.from_numpy(poses).float()[None], lenses, self.size),
            depth=torch.from_numpy(np.stack([one.depth for one in casts]) / shot.unit).float()[None],
            names=tuple(f"{self.name(scene)}/{view:03d}" for view in views),
        )

    def _check(self, scene: int) -> None:
        if not 0 <= scene < self.num_scenes:
            raise UserError(f"scene {scene}: there are {self.num_scenes}, counted from 0")

    def _find(self, scene: int) -> Shot:
        """Draw scenes until one passes; the last one is taken as it is."""
        for attempt in range(ATTEMPTS):
            draw = Draw((self.seed, SPLITS.index(self.split), scene, attempt))
            poses, focal = _path(draw, self.views)
            shot = _inspect(lay_out(draw, poses[:, :3, 3]), poses, focal)
            if shot is not None:
                return shot
        raise AssertionError(f"no acceptable scene in {ATTEMPTS} draws")


class _Cast(NamedTuple):
    color: Float64Array
    depth: Float64Array
    labels: NDArray[np.int64]


def _cast(world: World, pose: Float64Array, focal: float, size: tuple[int, int], samples: int) -> _Cast:
    found = _Cast(np.empty((*size, 3)), np.empty(size), np.empty(size, np.int64))
    cast((world.settings, world.solids, world.materials, volumes()), pose, focal, *found, samples)
    return found


def _develop(linear: Float64Array, exposure: float) -> NDArray[np.uint8]:
    """8-bit sRGB-like levels of linear light: a soft shoulder, then a gamma of 2, which is exact everywhere."""
    light = linear * exposure
    light = light * (1.0 + light * 0.25) / (1.0 + light)
    return (np.sqrt(np.clip(light, 0.0, 1.0)) * 255.0 + 0.5).astype(np.uint8)


def _look_at(eye: Float64Array, target: Float64Array, roll: float) -> Float64Array:
    """World from camera; OpenCV axes in the camera, y up in the world."""
    forward = target - eye
    forward = forward / np.sqrt((forward * forward).sum())
    right = np.array([-forward[2], 0.0, forward[0]])
    right = right / np.sqrt((right * right).sum())
    down = np.cross(forward, right)
    c, s = unit_circle(roll)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = c * right + s * down, c * down - s * right, forward, eye
    return pose


def _path(draw: Draw, views: int) -> tuple[Float64Array, float]:
    """Cameras along an arc that also rises, approaches and wanders; and the focal length in shorter sides."""
    arc, start = draw.between(0.18, 0.87), draw.between(-np.pi, np.pi)
    radius, height = draw.between(2.9, 4.4), draw.between(0.7, 2.0)
    approach, rise = draw.between(-0.22, 0.22), draw.between(-0.35, 0.35)
    slide = draw.between(-0.5, 0.5)
    target = np.array([draw.between(-0.5, 0.5), draw.between(0.25, 0.8), draw.between(-0.5, 0.5)])
    focal = draw.between(0.78, 1.15)
    poses = []
    for view in range(views):
        # Views are spread evenly on the arc with some freedom, in capture order.
        along = (view + draw.between(0.1, 0.9)) / views - 0.5
        c, s = unit_circle(start + arc * along)
        distance = radius * (1.0 + approach * 2 * along + draw.between(-0.04, 0.04))
        eye = np.array([distance * c, height * (1.0 + rise * 2 * along) + draw.between(-0.08, 0.08), distance * s])
        aim = target + slide * along * np.array([-s, 0.0, c])
        aim = aim + np.array([draw.between(-0.12, 0.12), draw.between(-0.1, 0.1), draw.between(-0.12, 0.12)])
        poses.append(_look_at(eye, aim, draw.between(-0.06, 0.06)))
    return np.stack(poses), focal


def _inspect(world: World, poses: Float64Array, focal: float) -> Shot | None:
    """Accept or reject a scene by small previews of all its views."""
    beyond = np.abs(poses[:, [0, 2], 3]) + 0.25 > world.settings[EXTENT : EXTENT + 3 : 2]
    if world.settings[ROOM] > 0 and beyond.any():
        return None
    depths: list[Float64Array] = []
    for pose in poses:
        _, depth, labels = _cast(world, pose, focal * PREVIEW, (PREVIEW, PREVIEW), 0)
        if not _presentable(depth, labels):
            return None
        depths.append(depth)
    if _shared(poses, focal, depths) < 0.4:
        return None
    color = _cast(world, poses[len(poses) // 2], focal * PREVIEW, (PREVIEW, PREVIEW), 1).color
    return Shot(world, poses, focal, float(depths[0].mean()), EXPOSED / float(color.mean()))


def _presentable(depth: Float64Array, labels: NDArray[np.int64]) -> bool:
    """Whether nothing near fills the view and something stands in it."""
    counts = np.bincount(labels.ravel()) / labels.size
    if depth.min() < 0.9 or len(counts) <= SOLIDS:
        return False
    things = counts[SOLIDS:]
    near = depth < 0.45 * np.median(depth)
    return bool(things.max() < 0.3 and 0.12 < things.sum() < 0.75 and (things > 0.01).sum() >= 3 and near.mean() < 0.3)


def _shared(poses: Float64Array, focal: float, depths: list[Float64Array]) -> float:
    """The smallest fraction of the first view's pixels that another view sees too."""
    grid = (np.arange(PREVIEW) + 0.5 - PREVIEW / 2) / (focal * PREVIEW)
    x, y = np.meshgrid(grid, grid)
    local = np.stack([x, y, np.ones_like(x)], -1) * depths[0][..., None]
    points = local @ poses[0, :3, :3].T + poses[0, :3, 3]
    fractions = []
    for pose, depth in zip(poses[1:], depths[1:], strict=True):
        p = (points - pose[:3, 3]) @ pose[:3, :3]
        u, v = (p[..., 0] / p[..., 2], p[..., 1] / p[..., 2]) if (p[..., 2] > 0).all() else (np.full_like(x, 9.0),) * 2
        column, row = (np.floor(a * focal * PREVIEW + PREVIEW / 2).astype(np.int64) for a in (u, v))
        inside = (column >= 0) & (column < PREVIEW) & (row >= 0) & (row < PREVIEW)
        seen = depth[row.clip(0, PREVIEW - 1), column.clip(0, PREVIEW - 1)]
        fractions.append((inside & (np.abs(seen - p[..., 2]) < 0.15 * p[..., 2])).mean())
    return float(min(fractions, default=1.0))
