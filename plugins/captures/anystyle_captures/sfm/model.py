"""What structure from motion works on: photographs with their lenses, pairs of them and matches, sparse models."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import hypot
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float64, UInt8
from PIL import ExifTags, Image

from anystyle_captures.panorama import Cut

Array = np.ndarray
FULL_FRAME_DIAGONAL = hypot(36, 24)
"""The diagonal of a 35 mm film frame, in millimetres, which equivalent focal lengths refer to."""


@dataclass(frozen=True)
class Photograph:
    """An upright sRGB picture, with the lens and the focal length in pixels where they are known.

    Photographs of the same lens and size share their intrinsics. No feature is taken where the mask is black. A
    panorama says how it is cut; its camera is that of its first view.
    """

    name: str
    pixels: UInt8[Array, "H W 3"]
    focal_length: float | None = None
    lens: str = ""
    mask: UInt8[Array, "H W"] | None = None
    cut: Cut | None = None

    @property
    def searched_size(self) -> tuple[int, int]:
        """Height and width of what features are searched in: of a panorama those of its views."""
        if self.cut is None:
            return self.size
        side = self.cut.side(self.size[1])
        return side, side

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.pixels.shape[0], self.pixels.shape[1]

    @classmethod
    def from_exif(cls, name: str, pixels: UInt8[Array, "H W 3"], exif: Image.Exif) -> "Photograph":
        """A photograph with the lens that its EXIF data describe."""
        details = exif.get_ifd(ExifTags.IFD.Exif)
        tags = [exif.get(ExifTags.Base.Make), exif.get(ExifTags.Base.Model)]
        tags += [details.get(tag) for tag in (ExifTags.Base.LensModel, ExifTags.Base.FocalLength)]
        lens = " ".join(str(tag).strip() for tag in tags if tag is not None)
        return cls(name, pixels, _focal_length(details, *pixels.shape[:2]), lens)


def _focal_length(details: dict[int, object], height: int, width: int) -> float | None:
    equivalent = _number(details.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if equivalent:
        return equivalent / FULL_FRAME_DIAGONAL * hypot(height, width)
    # Millimetres, and sensor pixels per unit of length at the recorded size.
    focal = _number(details.get(ExifTags.Base.FocalLength))
    density = _number(details.get(ExifTags.Base.FocalPlaneXResolution))
    unit = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}.get(int(_number(details.get(ExifTags.Base.FocalPlaneResolutionUnit))))
    recorded = max(_number(details.get(tag)) for tag in (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight))
    if not (focal and density and unit and recorded):
        return None
    return focal * density / unit * max(height, width) / recorded


def _number(value: object) -> float:
    """A positive finite number, else 0: cameras write nothing, zeros, and fractions with denominator zero."""
    try:
        number = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if 0 < number < float("inf") else 0.0


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

    @property
    def reaches_border(self) -> Bool[Array, " V"]:
        """Whether the lens of a registered view sees the nearest border: radii of a barrel end at 2 / sqrt(-27 k)."""
        return -27 * self.lenses[:, 3] * np.square(self.lenses[:, 1:3].min(1) / self.lenses[:, 0]) <= 4

    def reordered(self, order: Sequence[int]) -> "SparseModel":
        """The same model, where view ``i`` becomes view ``order[i]``."""
        back = np.argsort(order)
        return SparseModel(self.world_from_camera[back], self.lenses[back], self.points, self.seen[:, back])

    def restricted(self, views: Sequence[int]) -> "SparseModel":
        """The same model with only these views, and the points that at least two of them see."""
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


MIN_VIEWS = 3
"""Smaller models are dropped: a third view is the first that can contradict the others."""
EXHAUSTIVE = 300
"""Up to this many pairs (25 photographs), all pairs of unordered photographs are matched."""
NEIGHBORS = 5
"""In a video each frame is matched with this many next ones, and with those 2, 4, 8 ... times as far."""
PARTNERS, PREVIEW, RATIO, MIN_ALIKE = 10, 256, 0.8, 6
"""More photographs are each matched with the most similar ones: by at least ``MIN_ALIKE`` matches that pass the ratio
test among the ``PREVIEW`` features of largest scale."""


@dataclass(frozen=True)
class SearchOptions:
    """How cameras are searched for."""

    min_side: int = 512  # smaller photographs are enlarged to this longer side: SIFT finds few features in them
    max_side: int = 768
    num_features: int = 1500  # of each photograph, the strongest
    min_contrast: float = 0.02 / 3  # of a feature, in the range of grey values
    min_inliers: int = 15  # matches with which the incremental mapper tries to register a view
    seed: int = 0


SEARCHES = (SearchOptions(), SearchOptions(max_side=1600, num_features=8000, min_contrast=0.003))
"""The second is begun where the first leaves photographs out that have more pixels than it looked at. More features of
the same pixels find wrong places (docs/notes/2026-11-captures.md)."""


class VerifiedPair(NamedTuple):
    """Two photographs with matches that one motion of a rigid scene explains."""

    first: int
    second: int
    pixels: Float[Array, "2 M 2"]  # of the matches in both, in the size searched


class ViewGraph(NamedTuple):
    """What is known of photographs before they are mapped."""

    names: Sequence[str]
    num_features: Sequence[int]
    sizes: Sequence[tuple[int, int]]  # height and width in which features were searched
    pairs: Sequence[VerifiedPair]


def largest_features(keypoints: Float[Array, "N 6"], descriptors: Array) -> Float[Array, "M 128"]:
    """Unit descriptors of the features of largest scale; keypoints are x, y and the rows of an affine shape."""
    scale = np.linalg.norm(keypoints[:, 2:4], axis=1)
    largest = descriptors[np.argsort(-scale, kind="stable")[:PREVIEW]].astype(np.float32)
    return largest / np.linalg.norm(largest, axis=1, keepdims=True).clip(1e-6)


def pairs_to_match(previews: Sequence[Float[Array, "_ 128"]], ordered: bool, views: int = 1) -> list[tuple[int, int]]:
    """Pairs (first, second) with first < second to match in full, not of the same of photographs of so many views.

    All pairs if there are few photographs; otherwise those that share most of their largest features (preemptive
    matching, Wu, *Towards Linear-time Incremental Structure from Motion*, 3DV 2013), and in a video neighbours in time.
    """
    count = len(previews)
    pairs = [(first, second) for first, second in combinations(range(count), 2) if first // views != second // views]
    if len(pairs) <= EXHAUSTIVE and not ordered:
        return pairs
    chosen: set[tuple[int, int]] = set()
    if ordered:
        steps = list(range(1, NEIGHBORS + 1))
        while 2 * steps[-1] * views < count:
            steps.append(2 * steps[-1])
        chosen = {(first, first + step * views) for step in steps for first in range(count - step * views)}
    if len(pairs) > EXHAUSTIVE:
        scores = np.zeros((count, count), dtype=np.int64)
        for first, second in pairs:
            scores[first, second] = scores[second, first] = _num_matches(previews[first], previews[second])
        for view, partners in enumerate(np.argsort(-scores, axis=1, kind="stable")[:, :PARTNERS].tolist()):
            similar = [other for other in partners if scores[view, other] >= MIN_ALIKE]
            chosen |= {(min(view, other), max(view, other)) for other in similar}
    return sorted(chosen)


def _num_matches(first: Float[Array, "N 128"], second: Float[Array, "M 128"]) -> int:
    """How many features of the first have a match in the second that passes the ratio test."""
    if not len(first) or len(second) < 2:
        return 0
    nearest = np.partition(2 - 2 * first @ second.T, 1, axis=1)[:, :2].clip(0)
    return int((nearest[:, 0] < RATIO**2 * nearest[:, 1]).sum())
