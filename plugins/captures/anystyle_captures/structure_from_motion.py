"""Cameras by structure from motion, and the photographs as views with them."""

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import fsum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float64
from PIL import Image

from anystyle.contracts import PosedViews, PoseEstimator, Verdict
from anystyle.data.folder import as_views, common_size, cover, require_views, tell_of_cut
from anystyle.geometry.transforms import Similarity
from anystyle.types import Cameras, OnProgress, Original, no_progress
from anystyle_captures.cache import cached, key_of
from anystyle_captures.camera_files.lens import Lens
from anystyle_captures.panorama import Cut, cut_of
from anystyle_captures.sfm.colmap import search
from anystyle_captures.sfm.model import MIN_VIEWS, SEARCHES, Photograph, SearchOptions, SparseModel
from anystyle_captures.sfm.trust import judge
from anystyle_methods.order import canonical_order

logger = logging.getLogger(__name__)


class StructureFromMotion(PoseEstimator):
    """Cameras by structure from motion, cached for the next run with the same photographs.

    Args:
        keep: Whether the result is cached.
    """

    min_views = MIN_VIEWS
    longest = 1600
    reconstruction = "fit"

    def __init__(self, *, keep: bool = True) -> None:
        self.keep = keep

    def __call__(
        self, originals: Sequence[Original], *, short_side: int, multiple: int, enlarge: bool, on_progress: OnProgress
    ) -> PosedViews | Verdict:
        """Find cameras in the frame of the most central one, whose median point lies at depth 1."""
        cut, originals = cut_of(originals)
        photographs = [
            replace(
                Photograph.from_exif(original.name, np.array(original.picture.convert("RGB")), original.exif),
                mask=None if original.mask is None else np.array(original.mask),
                cut=cut,
            )
            for original in originals
        ]
        result = find_cameras(
            photographs,
            ordered=all(original.path is None for original in originals),
            threads=torch.get_num_threads(),
            keep=self.keep,
            on_progress=on_progress,
        )
        model = result.model
        registered = np.flatnonzero(model.registered).tolist()
        if len(registered) < MIN_VIEWS:
            return result.verdict
        if cut is None:
            shots = [_shot(originals[view], photographs[view], model, view) for view in registered]
        else:
            shots = [shot for view in registered for shot in _cut_shots(cut, originals[view], model, view)]
        size = common_size([shot.size for shot in shots], short_side=short_side, multiple=multiple, enlarge=enlarge)
        require_views(len(shots), size)
        pictures, intrinsics = [], []
        for shot in shots:
            whole = shot.picture.convert("RGB")
            straight = whole if shot.straighten is None else shot.straighten(whole)
            picture, source = cover(shot.name, straight, shot.size, size, whole=True)
            pictures.append((picture, replace(source, path=shot.path, straightened=shot.straighten)))
            intrinsics.append(source.view_intrinsics(torch.from_numpy(shot.intrinsics)))
        sources = tuple(source for _, source in pictures)
        tell_of_cut(sources)
        scene_from_world = _central_frame(shots)
        poses = scene_from_world.poses(torch.from_numpy(np.stack([shot.world_from_camera for shot in shots])))
        cameras = Cameras(poses.float()[None], torch.stack(intrinsics).float()[None], size)
        return PosedViews(
            as_views(pictures, cameras),
            sources,
            tuple(scene_from_world.points(torch.from_numpy(shot.points)).float() for shot in shots),
            result.verdict,
            result.cached,
        )


class _Posed(NamedTuple):
    """A view that is to be: a picture and what straightens it, then of ``size``, width and height, with a camera."""

    name: str
    path: Path | None
    picture: Image.Image
    straighten: Callable[[Image.Image], Image.Image] | None
    size: tuple[int, int]
    intrinsics: Float64[np.ndarray, "3 3"]
    world_from_camera: Float64[np.ndarray, "4 4"]
    points: Float64[np.ndarray, "P 3"]


def _shot(original: Original, photograph: Photograph, model: SparseModel, view: int) -> _Posed:
    """A registered photograph without the distortion of its lens."""
    (focal, x, y, radial), (height, width) = model.lenses[view].tolist(), original.size
    lens = Lens(photograph.size, (focal, focal), (x, y), (radial, 0.0, 0.0, 0.0))
    straight = lens.undistortion()
    straighten, matrix = (None, lens.matrix()) if straight is None else (straight.apply, straight.intrinsics)
    # The lens is in pixels of the photograph, which may be reduced in size.
    scales = np.array([width / photograph.size[1], height / photograph.size[0], 1.0])
    intrinsics, pose = matrix * scales[:, None], model.world_from_camera[view]
    points = model.points[model.seen[:, view]]
    return _Posed(original.name, original.path, original.picture, straighten, (width, height), intrinsics, pose, points)


def _cut_shots(cut: Cut, original: Original, model: SparseModel, view: int) -> Iterator[_Posed]:
    """The views of a registered panorama; each sees the panorama's points that lie in it."""
    side, points = cut.side(original.size[1]), model.points[model.seen[:, view]]
    for index, (name, rotation) in enumerate(zip(cut.names, cut.panorama_from_view, strict=True)):
        pose = model.world_from_camera[view].copy()
        pose[:3, :3] = pose[:3, :3] @ rotation
        x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
        inside = points[np.maximum(abs(x), abs(y)) < cut.slope * z]
        called, straighten = f"{original.name}_{name}", partial(cut.view, index)
        matrix = cut.intrinsics(side)
        yield _Posed(called, original.path, original.picture, straighten, (side, side), matrix, pose, inside)


@dataclass(frozen=True)
class FoundCameras:
    """The cameras of one capture."""

    model: SparseModel
    verdict: Verdict
    cached: bool = False


def find_cameras(
    photographs: Sequence[Photograph],
    *,
    ordered: bool = False,
    searches: Sequence[SearchOptions] = SEARCHES,
    threads: int = 1,
    keep: bool = False,
    on_progress: OnProgress = no_progress,
) -> FoundCameras:
    """Find where photographs of one rigid scene were taken, by their features and COLMAP's two mappers.

    Further searches follow while photographs lack a confirmed camera and have more pixels than were searched. A search
    whose verdict is good is preferred, then the one that finds most cameras. The same photographs and searches give the
    same cameras, bit for bit, on any number of threads and in whatever order they are given, unless they are ordered. A
    failure raises nothing: the verdict states it.
    """
    names = [photograph.name for photograph in photographs]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"{len(names)} photographs with {len(set(names))} names; give one or more, of distinct names")
    tensors = (torch.tensor(photograph.pixels) for photograph in photographs)
    order = list(range(len(names))) if ordered else canonical_order(tensors, names)
    arranged = [photographs[view] for view in order]

    def compute() -> dict[str, Any]:
        def judged(options: SearchOptions) -> tuple[SparseModel, Verdict]:
            return judge(*search(arranged, options, ordered=ordered, threads=threads, on_progress=on_progress))

        _, model, verdict = best_search(arranged, searches, judged)
        arrays = {name: torch.from_numpy(array) for name, array in vars(model).items()}
        return {"model": arrays, "verdict": {**vars(verdict), "measures": dict(verdict.measures)}}

    lenses = [(photograph.name, photograph.focal_length, photograph.lens) for photograph in arranged]
    pixels = [photograph.pixels for photograph in arranged]
    cuts = [photograph.cut for photograph in arranged if photograph.cut is not None]
    masks = [(view, photograph.mask) for view, photograph in enumerate(arranged) if photograph.mask is not None]
    key = key_of(*pixels, lenses, ordered, searches, *chain.from_iterable(masks), *cuts) if keep else None
    values, from_cache = cached("cameras", key, compute)
    model = SparseModel(**{name: tensor.numpy() for name, tensor in values["model"].items()})
    return FoundCameras(model.reordered(order), Verdict(**values["verdict"]), from_cache)


class Searched(NamedTuple):
    """What a search at a longer side of so many pixels found."""

    pixels: int
    model: SparseModel
    verdict: Verdict

    @property
    def registered(self) -> int:
        """Photographs with a camera."""
        return int(self.model.registered.sum())

    @property
    def good(self) -> bool:
        """Whether the cameras are confirmed."""
        return self.verdict.trust == "good"


def best_search(
    photographs: Sequence[Photograph],
    searches: Sequence[SearchOptions],
    judged: Callable[[SearchOptions], tuple[SparseModel, Verdict]],
) -> Searched:
    """Search until all photographs have a confirmed camera, and choose the best; ``judged`` does one search."""
    longer, count = max(max(photograph.searched_size) for photograph in photographs), len(photographs)
    found: list[Searched] = []
    for previous, options in zip([None, *searches[:-1]], searches, strict=True):
        if previous is not None and longer <= previous.max_side:
            break  # more features of the same pixels find wrong places
        pixels = min(longer, options.max_side)
        if found:
            logger.info(
                "%d of %d photographs have a camera by SIFT at %d pixels; searching again by SIFT at %d pixels",
                *(found[-1].registered, count, found[-1].pixels, pixels),
            )
        found.append(Searched(pixels, *judged(options)))
        if count < MIN_VIEWS or (found[-1].good and found[-1].registered == count):
            break
    best = max(found, key=lambda searched: (searched.good, searched.registered))
    if len(found) > 1:
        where = best.registered, count, best.pixels
        logger.info("the cameras of %d of %d photographs are by SIFT at %d pixels", *where)
    return best


def _central_frame(shots: Sequence[_Posed]) -> Similarity:
    """To the frame of the camera nearest to all others, in the unit in which the median of its points is at depth 1."""
    positions = np.stack([shot.world_from_camera[:3, 3] for shot in shots])
    distances = np.linalg.norm(positions[:, None] - positions, axis=-1)
    # ``fsum`` rounds once, so that the order of photographs does not matter.
    central = shots[int(np.argmin([fsum(row) for row in distances]))]
    camera_from_world = torch.linalg.inv(torch.from_numpy(central.world_from_camera))
    seen = torch.from_numpy(central.points)
    depth = (seen @ camera_from_world[:3, :3].T + camera_from_world[:3, 3])[:, 2].median()
    return Similarity(1 / depth, camera_from_world[:3, :3], camera_from_world[:3, 3] / depth)
