"""Sparse models: cameras, points and where the cameras see them, as plain arrays."""

from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int
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
