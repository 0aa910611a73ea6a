"""Cameras by structure from motion, and the photographs as views with them."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import fsum
from typing import Any, NamedTuple

import numpy as np
import torch
from PIL import Image

from anystyle.contracts import PosedViews, PoseEstimator, Verdict
from anystyle.data.folder import as_views, common_size, cover, require_views, tell_of_cut
from anystyle.geometry.transforms import Similarity
from anystyle.methods.order import canonical_order
from anystyle.types import Cameras, OnProgress, Original, no_progress
from anystyle_captures.cache import cached, key_of
from anystyle_captures.sfm.colmap import search
from anystyle_captures.sfm.model import (
    MIN_VIEWS,
    SEARCHES,
    Photograph,
    SearchOptions,
    SimpleRadial,
    SparseModel,
)
from anystyle_captures.sfm.trust import judge

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
        self,
        originals: Sequence[Original],
        *,
        short_side: int,
        multiple: int,
        enlarge: bool,
        on_progress: OnProgress,
    ) -> PosedViews | Verdict:
        """Find cameras in the frame of the most central one, whose median point lies at depth 1."""
        photographs = [
            replace(
                Photograph.from_exif(original.name, np.array(original.picture.convert("RGB")), original.exif),
                mask=None if original.mask is None else np.array(original.mask),
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
        sizes = [(original.size[1], original.size[0]) for original in originals]
        shown = [sizes[view] for view in registered]
        size = common_size(shown, short_side=short_side, multiple=multiple, enlarge=enlarge)
        require_views(len(registered), size)
        pictures, intrinsics = [], []
        for view in registered:
            original, photograph, lens = originals[view], photographs[view], model.lens(view)
            undistorted = Image.fromarray(lens.undistorted(photograph.pixels))
            picture, source = cover(original.name, undistorted, sizes[view], size, whole=True)
            straightened = partial(_undistorted, lens, photograph.size) if lens.is_distorted() else None
            pictures.append((picture, replace(source, path=original.path, straightened=straightened)))
            # The lens is in pixels of the photograph, which may be reduced in size.
            scales = [source.size[1] / photograph.size[1], source.size[0] / photograph.size[0], 1.0]
            matrix = lens.pinhole().intrinsics * np.array(scales)[:, None]
            intrinsics.append(source.view_intrinsics(torch.from_numpy(matrix)))
        sources = tuple(source for _, source in pictures)
        tell_of_cut(sources)
        scene_from_world = _central_frame(model, registered)
        poses = scene_from_world.poses(torch.from_numpy(model.world_from_camera[registered]))
        cameras = Cameras(poses.float()[None], torch.stack(intrinsics).float()[None], size)
        points = scene_from_world.points(torch.from_numpy(model.points)).float()
        return PosedViews(
            as_views(pictures, cameras),
            sources,
            tuple(points[torch.from_numpy(model.seen[:, view])] for view in registered),
            result.verdict,
            result.cached,
        )


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

        best = best_search(arranged, searches, judged)
        model, verdict = best.model, best.verdict
        arrays = {name: torch.from_numpy(array) for name, array in vars(model).items()}
        return {"model": arrays, "verdict": {**vars(verdict), "measures": dict(verdict.measures)}}

    lenses = [(photograph.name, photograph.focal_length, photograph.lens) for photograph in arranged]
    pixels = [photograph.pixels for photograph in arranged]
    masks = [(view, photograph.mask) for view, photograph in enumerate(arranged) if photograph.mask is not None]
    key = key_of(*pixels, lenses, ordered, searches, *chain.from_iterable(masks)) if keep else None
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
    longer, count = max(max(photograph.size) for photograph in photographs), len(photographs)
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


def _undistorted(lens: SimpleRadial, size: tuple[int, int], picture: Image.Image) -> Image.Image:
    """A picture drawn on a photograph of this height and width, such as a mask, without the lens's distortion."""
    return Image.fromarray(lens.undistorted(np.array(picture.convert("RGB").resize((size[1], size[0])))))


def _central_frame(model: SparseModel, registered: Sequence[int]) -> Similarity:
    """To the frame of the camera nearest to all others, in the unit in which the median of its points is at depth 1."""
    positions = model.world_from_camera[registered, :3, 3]
    distances = np.linalg.norm(positions[:, None] - positions, axis=-1)
    # ``fsum`` rounds once, so that the order of photographs does not matter.
    central = registered[int(np.argmin([fsum(row) for row in distances]))]
    camera_from_world = torch.linalg.inv(torch.from_numpy(model.world_from_camera[central]))
    seen = torch.from_numpy(model.points[model.seen[:, central]])
    depth = (seen @ camera_from_world[:3, :3].T + camera_from_world[:3, 3])[:, 2].median()
    return Similarity(1 / depth, camera_from_world[:3, :3], camera_from_world[:3, 3] / depth)
