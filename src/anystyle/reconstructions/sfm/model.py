"""Sparse models: cameras, points and where the cameras see them, as plain arrays."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float64, Int, UInt8
from numpy.typing import NDArray

Array = np.ndarray


@dataclass(frozen=True)
class Lens:
    """A pinhole with one term of radial distortion, in pixels; COLMAP's ``SIMPLE_RADIAL`` with two focal lengths.

    A direction (x, y) at z = 1 is seen at ``focal * (1 + radial * (x² + y²)) * (x, y) + center``.

    Args:
        focal: Along x and along y.
        center: Of the image, x and y; the centre of the first pixel is (0.5, 0.5).
        radial: The term's factor; negative for a barrel.
        size: Height and width of the images.
    """

    focal: tuple[float, float]
    center: tuple[float, float]
    radial: float
    size: tuple[int, int]

    @property
    def intrinsics(self) -> Float64[Array, "3 3"]:
        """The matrix, without distortion."""
        return np.array([[self.focal[0], 0, self.center[0]], [0, self.focal[1], self.center[1]], [0, 0, 1.0]])


@dataclass(frozen=True)
class Tracks:
    """Which view sees which point where.

    Args:
        point: Index of the point of each observation.
        view: Index of the view.
        pixel: Where, x and y in pixels of the view.
    """

    point: Int[Array, " O"]
    view: Int[Array, " O"]
    pixel: Float64[Array, "O 2"]


@dataclass(frozen=True)
class SparseModel:
    """What structure from motion says of photographs, in a frame and unit of its own.

    Args:
        world_from_camera: OpenCV axes; NaN for a view that has no place in the model.
        lenses: One a view; ``None`` where the model has none.
        points: Positions in the world.
        tracks: Their observations by views that have a place.
    """

    world_from_camera: Float64[Array, "V 4 4"]
    lenses: tuple[Lens | None, ...]
    points: Float64[Array, "P 3"]
    tracks: Tracks

    def as_dict(self) -> dict[str, Any]:
        """Tensors and plain values that :meth:`from_dict` takes."""
        return {
            "poses": torch.from_numpy(self.world_from_camera),
            "points": torch.from_numpy(self.points),
            "lenses": [lens and asdict(lens) for lens in self.lenses],
            "tracks": {name: torch.from_numpy(column) for name, column in vars(self.tracks).items()},
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "SparseModel":
        """What :meth:`as_dict` gave."""
        lenses = tuple(lens and Lens(**lens) for lens in values["lenses"])
        tracks = Tracks(**{name: column.numpy() for name, column in values["tracks"].items()})
        return cls(values["poses"].numpy(), lenses, values["points"].numpy(), tracks)

    @property
    def registered(self) -> Bool[Array, " V"]:
        """Which views have a place in the model."""
        return np.asarray(np.isfinite(self.world_from_camera).all((1, 2)))

    @property
    def num_registered(self) -> int:
        """How many views have a place in the model."""
        return int(self.registered.sum())

    def seen(self) -> Bool[Array, "P V"]:
        """Which points each view sees."""
        seen = np.zeros((len(self.points), len(self.world_from_camera)), dtype=bool)
        seen[self.tracks.point, self.tracks.view] = True
        return seen

    def rearranged(self, order: Sequence[int]) -> "SparseModel":
        """The same model where view ``i`` of this one stands at ``order[i]``."""
        back = np.argsort(order)
        tracks = replace(self.tracks, view=np.asarray(order)[self.tracks.view])
        lenses = tuple(self.lenses[view] for view in back)
        return replace(self, world_from_camera=self.world_from_camera[back], lenses=lenses, tracks=tracks)

    def restricted(self, views: NDArray[np.int64]) -> "SparseModel":
        """The same model with these views alone, and the points that at least two of them see."""
        kept = np.zeros(len(self.world_from_camera), dtype=bool)
        kept[views] = True
        pose = np.where(kept[:, None, None], self.world_from_camera, np.nan)
        point, view = self.tracks.point, self.tracks.view
        counts = np.bincount(point[kept[view]], minlength=len(self.points))
        chosen = kept[view] & (counts[point] >= 2)
        index = np.cumsum(counts >= 2) - 1
        tracks = Tracks(index[point[chosen]], view[chosen], self.tracks.pixel[chosen])
        return replace(self, world_from_camera=pose, points=self.points[counts >= 2], tracks=tracks)


def triangulation_angles(model: SparseModel) -> Float64[Array, " P"]:
    """The largest angle in degrees between two rays to each point."""
    towards = model.points[model.tracks.point] - model.world_from_camera[model.tracks.view, :3, 3]
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True).clip(1e-12)
    order = np.argsort(model.tracks.point, kind="stable")
    starts = np.searchsorted(model.tracks.point[order], np.arange(len(model.points) + 1))
    rays = towards[order]
    closest = [(rays[a:b] @ rays[a:b].T).min(initial=1.0) for a, b in pairwise(starts)]
    return np.degrees(np.arccos(np.clip(np.array(closest, dtype=np.float64), -1, 1)))


STRAIGHT = 0.1
"""Pixels of distortion at the corner that are left as they are."""
NEWTON = 8
"""Steps of inverting the distortion of a radius."""


def pinhole(lens: Lens) -> Lens:
    """The lens without distortion whose image is full and shows as much as it can.

    Focal lengths change by one factor; the centre and the size stay.
    """
    if not is_distorted(lens):
        return replace(lens, radial=0.0)
    border = undistorted_rays(lens, _border(lens))
    straight = np.abs(_border(lens) - lens.center) / lens.focal
    outward = straight > 1e-9
    # Every border pixel of the result must look at something inside of the photograph.
    factor = float((straight[outward] / np.abs(border[outward])).max())
    return replace(lens, focal=(lens.focal[0] * factor, lens.focal[1] * factor), radial=0.0)


def is_distorted(lens: Lens) -> bool:
    """Whether the distortion moves any pixel noticeably."""
    corner = np.hypot(lens.size[1] / 2 / lens.focal[0], lens.size[0] / 2 / lens.focal[1])
    return bool(abs(lens.radial) * corner**3 * max(lens.focal) > STRAIGHT)


def undistorted_image(pixels: UInt8[Array, "H W 3"], lens: Lens) -> UInt8[Array, "H W 3"]:
    """The photograph as the lens of :func:`pinhole` would have taken it, bilinearly resampled."""
    if not is_distorted(lens):
        return pixels
    straight, (height, width) = pinhole(lens), lens.size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = (np.stack([x, y], axis=-1) - straight.center) / straight.focal
    seen = rays * (1 + lens.radial * np.square(rays).sum(-1, keepdims=True)) * lens.focal + lens.center
    grid = torch.from_numpy(2 * seen / np.array([width, height]) - 1).float()
    image = torch.tensor(pixels).permute(2, 0, 1).float()
    sampled = F.grid_sample(image[None], grid[None], align_corners=False, padding_mode="border")[0]
    return sampled.round().byte().permute(1, 2, 0).numpy()


def undistorted_rays(lens: Lens, pixels: Float64[Array, "N 2"]) -> Float64[Array, "N 2"]:
    """Where rays through pixels of the photograph meet z = 1."""
    distorted = (pixels - lens.center) / lens.focal
    radius = np.linalg.norm(distorted, axis=-1, keepdims=True)
    straight = radius.copy()
    for _ in range(NEWTON):
        slope = (1 + 3 * lens.radial * straight**2).clip(0.1)
        straight -= (straight * (1 + lens.radial * straight**2) - radius) / slope
    return distorted * np.where(radius > 1e-12, straight / radius.clip(1e-12), 1.0)


def undistorted_model(model: SparseModel) -> SparseModel:
    """The same model with pinhole lenses, and tracks in pixels of the undistorted photographs."""
    pixels = model.tracks.pixel.copy()
    for view, lens in enumerate(model.lenses):
        seen = model.tracks.view == view
        if lens is not None and seen.any():
            straight = pinhole(lens)
            rays = undistorted_rays(lens, pixels[seen]) if is_distorted(lens) else None
            pixels[seen] = pixels[seen] if rays is None else rays * straight.focal + straight.center
    lenses = tuple(None if lens is None else pinhole(lens) for lens in model.lenses)
    return replace(model, lenses=lenses, tracks=Tracks(model.tracks.point, model.tracks.view, pixels))


def _border(lens: Lens) -> Float64[Array, "N 2"]:
    """Places all along the border of the image."""
    height, width = lens.size
    across, down = np.linspace(0, width, 65), np.linspace(0, height, 65)
    sides = [np.stack([across, np.full(65, y)], 1) for y in (0.0, float(height))]
    sides += [np.stack([np.full(65, x), down], 1) for x in (0.0, float(width))]
    return np.concatenate(sides)
