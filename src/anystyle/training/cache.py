"""Scenes kept on disk once they have been made or decoded."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from anystyle.contracts import SceneSource
from anystyle.types import Cameras, Views


class CachedScenes(SceneSource):
    """A scene source whose scenes are made once, and read from memory-mapped files after that.

    Images are kept as bytes and depth in half precision; the first read gives the same rounded values as later ones.
    Processes may share a directory: what two of them write at once is the same.

    Args:
        source: Scenes that all have one number of views, one size, cameras and depth.
        directory: Where the files go; one directory for one source.
    """

    def __init__(self, source: SceneSource, directory: str | Path) -> None:
        self.source = source
        first = _whole(source, 0)
        views, height, width = first.images.shape[1], *first.size
        count = len(source)
        directory = Path(directory)
        directory.mkdir(parents=True, exist_ok=True)
        self.size = (height, width)
        self._images = _map(directory / "images.u8", np.dtype(np.uint8), (count, views, 3, height, width))
        self._depth = _map(directory / "depth.f16", np.dtype(np.float16), (count, views, height, width))
        self._poses = _map(directory / "poses.f32", np.dtype(np.float32), (count, views, 4, 4))
        self._intrinsics = _map(directory / "intrinsics.f32", np.dtype(np.float32), (count, views, 3, 3))
        self._known = _map(directory / "known.u8", np.dtype(np.uint8), (count,))

    def __len__(self) -> int:
        return len(self.source)

    def name(self, scene: int) -> str:
        """The source's name for it."""
        return self.source.name(scene)

    def num_views(self, scene: int) -> int:
        """The same for every scene."""
        return self._images.shape[1]

    def read(self, scene: int, views: Sequence[int]) -> Views:
        """Some views of a scene, made now if never asked for before."""
        if not self._known[scene]:
            self._fill(scene)
        chosen = list(views)

        def rows(stored: np.ndarray) -> Tensor:
            return torch.from_numpy(stored[scene][chosen].astype(np.float32))[None]

        return Views(
            images=rows(self._images) / 255.0,
            cameras=Cameras(rows(self._poses), rows(self._intrinsics), self.size),
            depth=rows(self._depth),
        )

    def _fill(self, scene: int) -> None:
        made = _whole(self.source, scene)
        if made.images.shape[1:] != self._images.shape[1:]:
            raise ValueError(
                f"scene {self.source.name(scene)} has {made.images.shape[1]} views of {made.size}, the first scene "
                f"{self.num_views(0)} of {self.size}; a cache needs equal scenes: set cache=null"
            )
        assert made.cameras is not None and made.depth is not None
        self._images[scene] = (made.images[0] * 255.0).round().to(torch.uint8).numpy()
        self._depth[scene] = made.depth[0].numpy()
        self._poses[scene] = made.cameras.world_from_camera[0].numpy()
        self._intrinsics[scene] = made.cameras.intrinsics[0].numpy()
        self._known[scene] = 1


def _whole(source: SceneSource, scene: int) -> Views:
    views = source.read(scene, list(range(source.num_views(scene))))
    if views.cameras is None or views.depth is None:
        raise ValueError("only scenes with cameras and depth can be cached; set cache=null")
    return views


def _map(path: Path, dtype: np.dtype, shape: tuple[int, ...]) -> np.ndarray:
    size = int(np.prod(shape)) * dtype.itemsize
    with path.open("ab") as file:
        if file.tell() == 0:
            file.truncate(size)
    if path.stat().st_size != size:
        raise ValueError(f"{path} was made by another scene source; choose another cache or remove the directory")
    return np.memmap(path, dtype=dtype, mode="r+", shape=shape)
