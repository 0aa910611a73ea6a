"""One view on processors: the compiled kernels in order, as jobs for threads."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch

from anystyle.renderers.cpu import covariances, projection, projection_gradients, raster, sorting

CHUNK = 8192
"""Gaussians a job; fixed, so that no sum depends on the number of threads."""


class Scene(NamedTuple):
    """Gaussians of one scene, or gradients of them; ``shapes`` are covariances, packed."""

    means: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    harmonics: np.ndarray
    shapes: np.ndarray


class View(NamedTuple):
    """How one camera sees, as the kernels of :mod:`anystyle.renderers.cpu.projection` read it."""

    camera: np.ndarray
    limits: np.ndarray
    tables: np.ndarray


class Splats(NamedTuple):
    """The splats of one view, nearest first, where those of ascending Gaussians are, and the list of each tile row."""

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
        offsets, top = np.empty(-(-size[1] // sorting.WIDTH) + 1, np.int64), row * sorting.HEIGHT
        bottom = min(sorting.HEIGHT, size[0] - top) - 1
        return Tiles(sorting.tiles_of(self.data, self.members(row), top, bottom, size[1], offsets), offsets)


class Tiles(NamedTuple):
    """The splats of each tile in a row of tiles; see :func:`anystyle.renderers.cpu.sorting.tiles_of`."""

    lists: np.ndarray
    offsets: np.ndarray


Run = Callable[[Callable[[int], Any], Iterable[int]], Iterator[Any]]
"""``map``, perhaps with threads; results come in order."""


@contextmanager
def workers() -> Iterator[Run]:
    """Threads for jobs, as many as PyTorch uses."""
    threads = torch.get_num_threads()
    if threads == 1:
        yield map
        return
    # Threads of a call end with it, so that a process can fork between calls.
    with ThreadPoolExecutor(threads) as pool:
        yield pool.map


def shape(scene: Scene, run: Run) -> None:
    """Write the covariances of a scene, which are the same in all views."""
    number = len(scene.means)

    def job(start: int) -> None:
        covariances.covariances(scene.rotations, scene.scales, start, min(start + CHUNK, number), scene.shapes)

    for _ in run(job, range(0, number, CHUNK)):
        pass


def shape_backward(scene: Scene, into: Scene, run: Run) -> None:
    """Write the gradients of rotations and scales that follow from those of the covariances."""
    number = len(scene.means)

    def job(start: int) -> None:
        stop = min(start + CHUNK, number)
        covariances.covariances_backward(
            scene.rotations, scene.scales, start, stop, into.shapes, into.rotations, into.scales
        )

    for _ in run(job, range(0, number, CHUNK)):
        pass


def project(scene: Scene, view: View, height: int, run: Run) -> Splats:
    """Find what a view shows of a scene."""
    number = len(scene.means)
    data, owners = np.empty((number, projection.SPLAT), np.float32), np.empty(number, np.int32)

    def job(start: int) -> np.ndarray:
        stop = min(start + CHUNK, number)
        count = projection.project(
            scene.means, scene.shapes, scene.opacities, scene.harmonics, *view, start, stop, data, owners
        )
        return np.arange(start, start + count)

    rows = np.concatenate([np.empty(0, np.int64), *run(job, range(0, number, CHUNK))])
    nearest, ranks = np.empty((len(rows), projection.SPLAT), np.float32), np.empty(len(rows), np.int32)
    sorting.arrange(data, rows, sorting.nearest_first(data, rows), nearest, ranks)
    offsets = np.empty(-(-height // sorting.HEIGHT) + 1, np.int64)
    lists = sorting.rows_of(nearest, offsets)
    return Splats(nearest, owners[rows], ranks, lists, offsets)


def project_backward(
    scene: Scene, view: View, splats: Splats, moments: np.ndarray, into: Scene, posed: bool, run: Run
) -> np.ndarray:
    """Add a view's share to the gradients of a scene, but for rotations and scales, and return that of the camera.

    Which is of use only where it is asked for (``posed``).
    """
    number = len(splats.data)

    def job(start: int) -> np.ndarray:
        d_camera = np.zeros(projection.CAMERA)
        projection_gradients.project_backward(
            scene.means, scene.shapes, scene.harmonics, *view, start, min(start + CHUNK, number),
            splats.data, splats.owners, splats.ranks, moments,
            into.means, into.shapes, into.opacities, into.harmonics, posed, d_camera,
        )  # fmt: skip
        return d_camera

    return sum(run(job, range(0, number, CHUNK)), np.zeros(projection.CAMERA))


def blend(
    splats: Splats, cap: np.float32, image: np.ndarray, last: np.ndarray, run: Run, *, keep: bool = False
) -> list[Tiles]:
    """Write the image ``[5, H, W]`` of splats, and the last entry ``[H, W]`` of each pixel.

    Returns:
        The tiles of every row, where they are to be kept.
    """

    def job(row: int) -> Tiles | None:
        tiles = splats.tiles(row, last.shape)
        raster.blend(splats.data, *tiles, row * sorting.HEIGHT, cap, image, last)
        return tiles if keep else None

    return [tiles for tiles in run(job, range(len(splats.offsets) - 1)) if tiles is not None]


def blend_backward(
    splats: Splats,
    kept: list[Tiles],
    cap: np.float32,
    image: np.ndarray,
    last: np.ndarray,
    d_image: np.ndarray,
    run: Run,
) -> np.ndarray:
    """The moments ``[n, MOMENTS]`` of splats from the gradient of their image; tiles that were not kept are listed."""

    def job(row: int) -> np.ndarray:
        tiles = kept[row] if kept else splats.tiles(row, last.shape)
        moments = np.zeros((len(splats.members(row)), raster.MOMENTS), np.float32)
        raster.blend_backward(splats.data, *tiles, row * sorting.HEIGHT, cap, image, last, d_image, moments)
        return moments

    moments = np.zeros((len(splats.data), raster.MOMENTS), np.float32)
    for row, part in enumerate(run(job, range(len(splats.offsets) - 1))):
        raster.scatter(splats.members(row), part, moments)
    return moments
