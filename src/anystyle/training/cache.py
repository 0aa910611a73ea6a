"""Decoded scenes cached on disk."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from anystyle.contracts import SceneSource
from anystyle.types import Cameras, Views


class CachedScenes(SceneSource):
    """A scene source whose scenes are read from another one once, and from a memory-mapped file after that.

    Images are stored as bytes and depth in half precision; the first read gives the same rounded values as later ones.
    Processes may share a directory: they write equal bytes.

    Args:
        source: Scenes that all have one number of views, one size, cameras and depth.
        directory: Of the file; one directory for one source.
    """

    def __init__(self, source: SceneSource, directory: str | Path) -> None:
        self.source = source
        first = _read_all(source, 0)
        num_views, self.size = first.images.shape[1], first.size
        record = np.dtype(
            [
                ("filled", np.uint8),
                ("images", np.uint8, (num_views, 3, *self.size)),
                ("depth", np.float16, (num_views, *self.size)),
                ("poses", np.float32, (num_views, 4, 4)),
                ("intrinsics", np.float32, (num_views, 3, 3)),
            ]
        )
        Path(directory).mkdir(parents=True, exist_ok=True)
        self._scenes = _map(Path(directory) / "scenes.bin", record, len(source))

    def __len__(self) -> int:
        return len(self.source)

    def name(self, scene: int) -> str:
        return self.source.name(scene)

    def num_views(self, scene: int) -> int:
        """The same for every scene."""
        return self._scenes["images"].shape[1]

    def read(self, scene: int, views: Sequence[int]) -> Views:
        """Some views of a scene, read from its source the first time."""
        if not self._scenes["filled"][scene]:
            self._fill(scene)

        def stored(field: str) -> Tensor:
            return torch.from_numpy(self._scenes[field][scene][list(views)].astype(np.float32))[None]

        return Views(
            images=stored("images") / 255.0,
            cameras=Cameras(stored("poses"), stored("intrinsics"), self.size),
            depth=stored("depth"),
        )

    def _fill(self, scene: int) -> None:
        views = _read_all(self.source, scene)
        if views.images.shape[1:] != self._scenes["images"].shape[1:]:
            raise ValueError(
                f"scene {self.source.name(scene)} has {views.images.shape[1]} views of {views.size}, the first scene "
                f"{self.num_views(0)} of {self.size}; a cache needs equal scenes: set cache=null"
            )
        assert views.cameras is not None and views.depth is not None
        self._scenes["images"][scene] = (views.images[0] * 255.0).round().to(torch.uint8).numpy()
        self._scenes["depth"][scene] = views.depth[0].numpy()
        self._scenes["poses"][scene] = views.cameras.world_from_camera[0].numpy()
        self._scenes["intrinsics"][scene] = views.cameras.intrinsics[0].numpy()
        self._scenes["filled"][scene] = 1


def _read_all(source: SceneSource, scene: int) -> Views:
    views = source.read(scene, list(range(source.num_views(scene))))
    if views.cameras is None or views.depth is None:
        raise ValueError("only scenes with cameras and depth can be cached; set cache=null")
    return views


def _reserve(number: int, size: int, path: Path) -> None:
    """Room on the disk for a whole file."""
    try:
        if sys.platform == "linux":
            os.posix_fallocate(number, 0, size)
        else:
            os.truncate(number, size)
    except OSError as error:
        os.truncate(number, 0)
        raise OSError(
            f"{path} needs {size / 1e9:.2f} GB, and the disk does not take it ({error.strerror}); choose another cache "
            "or none"
        ) from None


def _map(path: Path, record: np.dtype, count: int) -> np.memmap:
    size = count * record.itemsize
    with path.open("ab") as file:
        if file.tell() == 0:
            # A file with holes ends in a bus error when the disk is full and a page of it is written.
            _reserve(file.fileno(), size, path)
    if path.stat().st_size != size:
        raise ValueError(f"{path} was made by another scene source; choose another cache or remove the directory")
    return np.memmap(path, dtype=record, mode="r+", shape=(count,))
