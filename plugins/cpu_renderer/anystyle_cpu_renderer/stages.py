"""The stages of rendering one view, each a compiled kernel split into jobs for threads."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch

from anystyle_cpu_renderer import projection, raster

CHUNK = 8192
"""Gaussians per job; fixed, so that the order of summation does not depend on the number of threads."""


class SceneArrays(NamedTuple):
    """Gaussians of one scene, or their gradients; ``shapes`` are packed covariances."""

    means: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    harmonics: np.ndarray
    shapes: np.ndarray


class CameraArrays(NamedTuple):
    """One camera, as arguments of the kernels in :mod:`anystyle_cpu_renderer.projection`."""

    camera: np.ndarray
    limits: np.ndarray
    tables: np.ndarray


class SortedSplats(NamedTuple):
    """The splats of one view.

    Args:
        data: ``[n, SPLAT]``, nearest first.
        owners: ``[n]``: the Gaussian of each splat, ascending.
        ranks: ``[n]``: the row in ``data`` of the splat of each of ``owners``.
        lists: Splats of each row of tiles, nearest first, concatenated.
        offsets: Where the list of each row of tiles begins and ends.
    """

    data: np.ndarray
    owners: np.ndarray
    ranks: np.ndarray
    lists: np.ndarray
    offsets: np.ndarray

    def members(self, row: int) -> np.ndarray:
        """Indices of the splats in a row of tiles, nearest first."""
        return self.lists[self.offsets[row] : self.offsets[row + 1]]

    def tiles(self, row: int, size: tuple[int, ...]) -> "Tiles":
        """The splats of each tile in a row of tiles of an image of a height and width."""
        offsets, top = np.empty(-(-size[1] // raster.WIDTH) + 1, np.int64), row * raster.HEIGHT
        bottom = min(raster.HEIGHT, size[0] - top) - 1
        return Tiles(raster.tiles_of(self.data, self.members(row), top, bottom, size[1], offsets), offsets)


class Tiles(NamedTuple):
    """The splats of each tile in a row of tiles; see :func:`anystyle_cpu_renderer.raster.tiles_of`."""

    lists: np.ndarray
    offsets: np.ndarray


Mapper = Callable[..., Iterator[Any]]
"""``map``, or its equivalent on threads; results are in order."""


@contextmanager
def workers() -> Iterator[Mapper]:
    """Run jobs on as many threads as PyTorch uses."""
    threads = torch.get_num_threads()
    if threads == 1:
        yield map
        return
    # Threads end with the call, so that the process can fork between calls.
    with ThreadPoolExecutor(threads) as pool:
        yield pool.map


def chunks(rows: np.ndarray) -> tuple[range, list[int]]:
    """First rows of jobs, and one past the last of each."""
    starts = range(0, len(rows), CHUNK)
    return starts, [min(start + CHUNK, len(rows)) for start in starts]


def shape(scene: SceneArrays, run: Mapper) -> None:
    """Write the covariances of a scene."""

    def job(start: int, stop: int) -> None:
        projection.covariances(scene.rotations, scene.scales, start, stop, scene.shapes)

    list(run(job, *chunks(scene.means)))


def shape_backward(scene: SceneArrays, into: SceneArrays, run: Mapper) -> None:
    """Write the gradients of rotations and scales, given those of the covariances."""

    def job(start: int, stop: int) -> None:
        projection.covariances_backward(
            scene.rotations, scene.scales, start, stop, into.shapes, into.rotations, into.scales
        )

    list(run(job, *chunks(scene.means)))


def project(scene: SceneArrays, view: CameraArrays, height: int, run: Mapper) -> SortedSplats:
    """Project the visible Gaussians of a scene into a view."""
    number = len(scene.means)
    data, owners = np.empty((number, projection.SPLAT), np.float32), np.empty(number, np.int32)

    def job(start: int, stop: int) -> np.ndarray:
        count = projection.project(
            scene.means, scene.shapes, scene.opacities, scene.harmonics, *view, start, stop, data, owners
        )
        return np.arange(start, start + count)

    rows = np.concatenate([np.empty(0, np.int64), *run(job, *chunks(scene.means))])
    nearest, ranks = np.empty((len(rows), projection.SPLAT), np.float32), np.empty(len(rows), np.int32)
    raster.arrange(data, rows, raster.nearest_first(data, rows), nearest, ranks)
    offsets = np.empty(-(-height // raster.HEIGHT) + 1, np.int64)
    lists = raster.rows_of(nearest, offsets)
    return SortedSplats(nearest, owners[rows], ranks, lists, offsets)


def project_backward(
    scene: SceneArrays,
    view: CameraArrays,
    splats: SortedSplats,
    moments: np.ndarray,
    into: SceneArrays,
    shaped: bool,
    posed: bool,
    run: Mapper,
) -> np.ndarray:
    """Accumulate gradients of a view into ``into``, except for rotations and scales; unless ``shaped``, of colours."""

    def job(start: int, stop: int) -> np.ndarray:
        d_camera = np.zeros(projection.CAMERA)
        projection.project_backward(
            scene.means, scene.shapes, scene.harmonics, *view, start, stop,
            splats.data, splats.owners, splats.ranks, moments,
            into.means, into.shapes, into.opacities, into.harmonics, shaped, posed, d_camera,
        )  # fmt: skip
        return d_camera

    return sum(run(job, *chunks(splats.data)), np.zeros(projection.CAMERA))


def blend(
    splats: SortedSplats, cap: np.float32, image: np.ndarray, last: np.ndarray, run: Mapper, *, keep: bool = False
) -> list[Tiles]:
    """Write the image ``[5, H, W]`` of splats, and the index ``[H, W]`` of the last entry that each pixel blended."""

    def job(row: int) -> Tiles | None:
        tiles = splats.tiles(row, last.shape)
        raster.blend(splats.data, *tiles, row * raster.HEIGHT, cap, image, last)
        return tiles if keep else None

    return [tiles for tiles in run(job, range(len(splats.offsets) - 1)) if tiles is not None]


def blend_backward(
    splats: SortedSplats,
    kept: list[Tiles],
    cap: np.float32,
    image: np.ndarray,
    last: np.ndarray,
    d_image: np.ndarray,
    shaped: bool,
    run: Mapper,
) -> np.ndarray:
    """The moments ``[n, MOMENTS]`` of splats, given the gradient of their image; lists tiles again if none are kept.

    Unless ``shaped``, only those of colours.
    """

    def job(row: int) -> np.ndarray:
        tiles = kept[row] if kept else splats.tiles(row, last.shape)
        moments = np.zeros((len(splats.members(row)), raster.MOMENTS), np.float32)
        raster.blend_backward(splats.data, *tiles, row * raster.HEIGHT, cap, image, last, d_image, moments, shaped)
        return moments

    moments = np.zeros((len(splats.data), raster.MOMENTS), np.float32)
    for row, part in enumerate(run(job, range(len(splats.offsets) - 1))):
        raster.scatter(splats.members(row), part, moments)
    return moments
