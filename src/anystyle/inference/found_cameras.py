"""Cameras by structure from motion, and the photographs as views with them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import fsum
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from anystyle.data.folder import Original, SourceImage, as_views, common_size, cover, read_originals
from anystyle.geometry.similarity import Similarity
from anystyle.inference.options import ViewOptions
from anystyle.reconstructions.sfm.cameras import PosedPhotographs, cameras_from_photographs
from anystyle.reconstructions.sfm.model import Lens, is_distorted, undistorted_image
from anystyle.reconstructions.sfm.photographs import photograph_with_exif
from anystyle.reconstructions.sfm.verdict import FEWEST_VIEWS, Verdict
from anystyle.types import Cameras, Views

LONGEST = 1600
"""Longer side in pixels that photographs are reduced to while cameras are sought; less than twice of it."""


@dataclass(frozen=True)
class FoundCameras:
    """The photographs whose cameras were found.

    Args:
        views: Undistorted, with cameras in the frame of the one nearest to all others; the median of the points that
            it sees lies at depth 1 there.
        sources: Where each view comes from.
        points: For each view, sparse points that it shows.
        verdict: How far the cameras can be trusted, and what was left out.
        kept: Whether they were found by an earlier run.
    """

    views: Views
    sources: tuple[SourceImage, ...]
    points: tuple[Float[Tensor, "_ 3"], ...]
    verdict: Verdict
    kept: bool = False


def read_photographs(inputs: Sequence[Path], options: ViewOptions) -> list[Original]:
    """The photographs of a capture, large enough for their cameras to be found.

    Raises:
        ValueError: Nothing can be read.
    """
    return read_originals(inputs, longest=LONGEST, max_views=options.take)


def find_cameras(
    originals: Sequence[Original],
    *,
    short_side: int,
    multiple: int,
    progress: Callable[[str], None],
    enlarge: bool = True,
    keep: bool = True,
) -> FoundCameras | Verdict:
    """Find the cameras of photographs, and make views of one size of those that have one.

    Args:
        originals: Of one scene.
        short_side: Of the views, in pixels; rounded to a multiple.
        multiple: Sides of views are multiples of it.
        progress: Told what is done.
        enlarge: Whether smaller photographs are brought to ``short_side``, too.
        keep: Whether what is found is kept for the next run with the same photographs.

    Returns:
        The verdict alone where there are no cameras.
    """
    photographs = [
        photograph_with_exif(original.name, np.array(original.picture.convert("RGB")), original.exif)
        for original in originals
    ]
    posed = cameras_from_photographs(
        photographs,
        ordered=all(original.path is None for original in originals),
        threads=torch.get_num_threads(),
        keep=keep,
        progress=lambda stage, done, total: progress(f"{stage}: {done} of {total}"),
    )
    registered = [int(view) for view in np.flatnonzero(posed.registered)]
    if len(registered) < FEWEST_VIEWS:
        return posed.verdict
    size = common_size(
        [_width_height(originals[view]) for view in registered],
        short_side=short_side,
        multiple=multiple,
        enlarge=enlarge,
    )
    pictures = [_covered(originals[view], posed, size) for view in registered]
    capture = _central_frame(posed, registered)
    sources = tuple(source for _, source in pictures)
    intrinsics = [_intrinsics(posed, originals[view], source) for view, source in zip(registered, sources, strict=True)]
    poses = capture.poses(torch.from_numpy(posed.world_from_camera[registered]))
    cameras = Cameras(poses.float()[None], torch.stack(intrinsics).float()[None], size)
    points = capture.points(torch.from_numpy(posed.points)).float()
    shown = [torch.from_numpy(posed.tracks.point[posed.tracks.view == view]) for view in registered]
    return FoundCameras(
        as_views(pictures, cameras),
        sources,
        tuple(points[seen] for seen in shown),
        posed.verdict,
        posed.kept,
    )


def _width_height(original: Original) -> tuple[int, int]:
    return original.size[1], original.size[0]


def _covered(original: Original, posed: PosedPhotographs, size: tuple[int, int]) -> tuple[Image.Image, SourceImage]:
    view = posed.names.index(original.name)
    picture, source = cover(original.name, Image.fromarray(posed.images[view]), _width_height(original), size)
    lens = posed.lenses[view]
    straightened = partial(_straightened, lens) if lens is not None and is_distorted(lens) else None
    return picture, replace(source, path=original.path, straightened=straightened)


def _straightened(lens: Lens, picture: Image.Image) -> Image.Image:
    """A picture drawn on a photograph, without the distortion of its lens."""
    return Image.fromarray(
        undistorted_image(np.array(picture.convert("RGB").resize((lens.size[1], lens.size[0]))), lens)
    )


def _intrinsics(posed: PosedPhotographs, original: Original, source: SourceImage) -> Float[Tensor, "3 3"]:
    """In pixels of the view; those found are in pixels of the photograph that may have been reduced."""
    view = posed.names.index(original.name)
    height, width = posed.images[view].shape[:2]
    scale = torch.tensor([original.size[1] / width, original.size[0] / height, 1.0], dtype=torch.float64)
    return source.view_intrinsics(torch.from_numpy(posed.intrinsics[view]) * scale[:, None])


def _central_frame(posed: PosedPhotographs, registered: Sequence[int]) -> Similarity:
    """To the frame of the camera nearest to all others, in the unit in which the median of its points is at depth 1."""
    positions = posed.world_from_camera[registered, :3, 3]
    distances = np.linalg.norm(positions[:, None] - positions, axis=-1)
    # Sums that are rounded once, and so the same in any order of photographs.
    central = registered[int(np.argmin([fsum(row) for row in distances]))]
    camera_from_world = torch.linalg.inv(torch.from_numpy(posed.world_from_camera[central]))
    seen = torch.from_numpy(posed.points[posed.tracks.point[posed.tracks.view == central]])
    depth = (seen @ camera_from_world[:3, :3].T + camera_from_world[:3, 3])[:, 2].median()
    return Similarity(1 / depth, camera_from_world[:3, :3], camera_from_world[:3, 3] / depth)
