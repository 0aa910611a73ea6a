"""The stages of rendering one view, each a compiled kernel split into jobs for threads."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from mmap import mmap
from threading import local
from typing import Any

import numpy as np
import torch

from anystyle_cpu_renderer import projection, raster
from anystyle_cpu_renderer.projection import CameraArrays, SceneArrays
from anystyle_cpu_renderer.raster import BlendedView, Shares, SortedSplats, Tiles

CHUNK = 8192
"""Gaussians per job; fixed, so that the order of summation does not depend on the number of threads."""


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
    list(run(partial(projection.covariances, scene), *chunks(scene.means)))


def shape_backward(scene: SceneArrays, into: SceneArrays, run: Mapper) -> None:
    """Write the gradients of rotations and scales, given those of the covariances."""

    def job(start: int, stop: int) -> None:
        projection.covariances_backward(scene, start, stop, into)

    list(run(job, *chunks(scene.means)))


class Buffers(local):
    """Arrays of a thread that are overwritten by its next view: new memory costs as much as what is written to it."""

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}

    def __call__(self, name: str, shape: tuple[int, ...], kind: type) -> np.ndarray:
        if name not in self._arrays or len(self._arrays[name]) < shape[0]:
            self._arrays[name] = np.empty(shape, kind)
        return self._arrays[name][: shape[0]]


BUFFERS = Buffers()


def project(scene: SceneArrays, view: CameraArrays, height: int, run: Mapper, *, keep: bool = False) -> SortedSplats:
    """Project the visible Gaussians of a scene into a view; unless kept, the result lasts until the thread's next."""
    number = len(scene.means)
    new = (lambda _, shape, kind: np.empty(shape, kind)) if keep else BUFFERS
    data, owners = new("data", (number, raster.SPLAT), np.float32), new("owners", (number,), np.int32)

    def job(start: int, stop: int) -> np.ndarray:
        return np.arange(start, start + projection.project(scene, view, start, stop, data, owners))

    rows = np.concatenate([np.empty(0, np.int64), *run(job, *chunks(scene.means))])
    offsets = np.empty(-(-height // raster.HEIGHT) + 1, np.int64)
    raster.count_by_row(data, rows, offsets)
    copies, places = new("copies", (offsets[-1], raster.SPLAT), np.float32), new("places", (offsets[-1],), np.int32)
    raster.copy_by_row(data, rows, offsets, copies, places)
    return SortedSplats(data, rows, owners, copies, places, offsets)


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
        projection.project_backward(scene, view, start, stop, splats, moments, into, shaped, posed, d_camera)
        return d_camera

    return sum(run(job, *chunks(splats.rows)), np.zeros(projection.CAMERA))


def blend(
    splats: SortedSplats, cap: np.float32, image: np.ndarray, last: np.ndarray, run: Mapper, *, keep: bool = False
) -> list[Tiles]:
    """Write the image ``[5, H, W]`` of splats, and the index ``[H, W]`` of the last entry that each pixel blended."""

    def job(row: int) -> Tiles | None:
        tiles = splats.tiles(row, last.shape)
        raster.blend(splats.copies[splats.of(row)], tiles, row * raster.HEIGHT, cap, image, last)
        return tiles if keep else None

    return [tiles for tiles in run(job, range(len(splats.offsets) - 1)) if tiles is not None]


def shares(splats: SortedSplats, cap: np.float32, image: np.ndarray, run: Mapper) -> list[Shares]:
    """The shares of Gaussians in the pixels of a view, by rows of tiles; the image ``[5, H, W]`` is written, too."""
    size = image.shape[1:]
    last = np.empty(size, np.int32)

    def job(row: int) -> Shares:
        tiles, top = splats.tiles(row, size), row * raster.HEIGHT
        part, owners = splats.copies[splats.of(row)], splats.owners[splats.places[splats.of(row)]]
        raster.blend(part, tiles, top, cap, image, last)
        found = raster.shares(part, owners, tiles, min(raster.HEIGHT, size[0] - top), size[1], top, cap)
        return Shares(*map(_mapped, found))

    return list(run(job, range(len(splats.offsets) - 1)))


def _mapped(array: np.ndarray) -> np.ndarray:
    """The same outside of the heap: what is kept would leave gaps there, which other sizes do not fill."""
    copy = np.ndarray(array.shape, array.dtype, mmap(-1, max(1, array.nbytes)))
    copy[:] = array
    return copy


def blend_backward(
    splats: SortedSplats, kept: list[Tiles], cap: np.float32, picture: BlendedView, shaped: bool, run: Mapper
) -> np.ndarray:
    """The moments ``[N, MOMENTS]`` of splats, given the gradient of their image; lists tiles again if none are kept.

    Unless ``shaped``, only those of colours.
    """

    def job(row: int) -> np.ndarray:
        tiles = kept[row] if kept else splats.tiles(row, picture.last.shape)
        part = splats.copies[splats.of(row)]
        moments = np.zeros((len(part), raster.MOMENTS), np.float32)
        raster.blend_backward(part, tiles, row * raster.HEIGHT, cap, picture, moments, shaped)
        return moments

    moments = np.zeros((len(splats.data), raster.MOMENTS), np.float32)
    for row, part in enumerate(run(job, range(len(splats.offsets) - 1))):
        raster.scatter(splats.places[splats.of(row)], part, moments)
    return moments
