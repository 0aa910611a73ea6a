"""Sparse models: cameras, points, and which camera sees which point, as plain arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float64

from anystyle_captures.sfm.lenses import Lens

Array = np.ndarray


@dataclass(frozen=True)
class SparseModel:
    """Cameras and points in a frame and unit of their own; NaN for views that are not registered."""

    world_from_camera: Float64[Array, "V 4 4"]
    lenses: Float64[Array, "V 4"]
    points: Float64[Array, "P 3"]
    seen: Bool[Array, "P V"]

    @classmethod
    def empty(cls, num_views: int) -> "SparseModel":
        """No view is registered."""
        poses, lenses = np.full((num_views, 4, 4), np.nan), np.full((num_views, 4), np.nan)
        return cls(poses, lenses, np.empty((0, 3)), np.empty((0, num_views), dtype=bool))

    @property
    def registered(self) -> Bool[Array, " V"]:
        """Which views have a camera."""
        return np.asarray(np.isfinite(self.world_from_camera).all((1, 2)))

    def lens(self, view: int) -> Lens:
        """The lens of a registered view."""
        return Lens(*self.lenses[view].tolist())

    def reordered(self, order: Sequence[int]) -> "SparseModel":
        """The same model, where view ``i`` becomes view ``order[i]``."""
        back = np.argsort(order)
        return SparseModel(self.world_from_camera[back], self.lenses[back], self.points, self.seen[:, back])

    def restricted(self, views: Sequence[int]) -> "SparseModel":
        """The same model with these views alone, and the points that at least two of them see."""
        keep = np.isin(np.arange(len(self.lenses)), views)
        seen = self.seen & keep
        points = seen.sum(1) >= 2
        return replace(
            self,
            world_from_camera=np.where(keep[:, None, None], self.world_from_camera, np.nan),
            lenses=np.where(keep[:, None], self.lenses, np.nan),
            points=self.points[points],
            seen=seen[points],
        )

    def triangulation_angles(self) -> Float64[Array, " P"]:
        """The largest angle in degrees between two rays to each point."""
        cosines = np.ones(len(self.points))
        centers = self.world_from_camera[:, :3, 3]
        views = np.flatnonzero(self.registered)
        rays = self.points[:, None] - centers[views]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True).clip(1e-12)
        for first, second in combinations(range(len(views)), 2):
            both = self.seen[:, views[first]] & self.seen[:, views[second]]
            cosines[both] = np.minimum(cosines[both], (rays[both, first] * rays[both, second]).sum(-1))
        return np.degrees(np.arccos(cosines.clip(-1, 1)))
