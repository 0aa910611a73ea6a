"""Caches of scenes: decoded ones on the disk, encoded ones in memory."""

import hashlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
import torch.nn.functional as F
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from anystyle.contracts import SceneSource
from anystyle.errors import UserError, one_line
from anystyle.io.atomic import atomic_path
from anystyle.io.cache import LRUCache
from anystyle.types import Cameras, Clusters, Scene, Views

logger = logging.getLogger(__name__)


def with_cache(source: SceneSource, folder: Path) -> SceneSource:
    """The source with a cache; itself, with a warning, if its scenes lack cameras or depth, as photographs do."""
    first = source.read(0, [0])
    if first.cameras is not None and first.depth is not None:
        return CachedScenes(source, folder)
    logger.warning("%s has no cameras or no depth: its scenes are not cached, but read anew each time", source.name(0))
    return source


class CachedScenes(SceneSource):
    """A scene source whose scenes are read from another one once, and from a file of their own after that.

    Images are stored as bytes and depth in half precision; the first read gives the same rounded values as later ones.
    Processes may share a folder; each source has its own one inside.
    """

    def __init__(self, source: SceneSource, folder: Path) -> None:
        self.source = source
        signature = hashlib.sha256(f"{len(source)} {source.name(0)}".encode(errors="surrogateescape"))
        for _, tensor in sorted(self._tensors(0).items()):
            signature.update(f"{tuple(tensor.shape)}".encode() + tensor.contiguous().numpy().tobytes())
        self.folder = folder / signature.hexdigest()[:16]

    def __len__(self) -> int:
        return len(self.source)

    def name(self, scene: int) -> str:
        return self.source.name(scene)

    def num_views(self, scene: int) -> int:
        return self.source.num_views(scene)

    def read(self, scene: int, views: Sequence[int]) -> Views:
        path = self.folder / f"{scene:06d}.safetensors"
        if path.is_file():
            tensors = load_file(path)
        else:
            tensors = self._tensors(scene)
            try:
                with atomic_path(path) as temporary:
                    save_file(tensors, temporary)
            except (OSError, SafetensorError) as error:
                logger.warning("%s cannot be written (%s); its scene is read anew each time", path, one_line(error))
        stored = {name: tensor[list(views)].float()[None] for name, tensor in tensors.items()}
        images = stored["images"] / 255.0
        size = (images.shape[-2], images.shape[-1])
        return Views(images, Cameras(stored["poses"], stored["intrinsics"], size), depth=stored["depth"])

    def _tensors(self, scene: int) -> dict[str, Tensor]:
        views = self.source.read(scene, list(range(self.source.num_views(scene))))
        if views.cameras is None or views.depth is None:
            raise UserError(f"{self.name(scene)} has no cameras or no depth and cannot be cached; set cache=null")
        tensors = {
            "images": (views.images[0] * 255.0).round().to(torch.uint8),
            "depth": views.depth[0].half(),
            "poses": views.cameras.world_from_camera[0],
            "intrinsics": views.cameras.intrinsics[0],
        }
        return {name: tensor.contiguous() for name, tensor in tensors.items()}


class EncodedScenes:
    """Encoded scenes by their key and image size, least recently used first out.

    Every scene is encoded by itself, cached or not: a batch is the same with and without the cache.
    """

    def __init__(self, encode: Callable[[Views], Scene], limit: int) -> None:
        self.encode = encode
        self._scenes: LRUCache[tuple[int, tuple[int, int]], Scene] = LRUCache(limit)

    def __call__(self, views: Views, keys: Sequence[int]) -> Scene:
        """The scenes of a batch of views, one key per row."""
        # The views of a key are the same each time, but their size may change from step to step.
        rows = (((key, views.size), partial(self.encode, views.row(row))) for row, key in enumerate(keys))
        return stack_scenes([self._scenes.get(key, encode) for key, encode in rows])


def stack_scenes(scenes: Sequence[Scene]) -> Scene:
    """One batch of scenes of equal shapes; clusters are padded to one count."""
    if len(scenes) == 1:
        return scenes[0]
    clusters = [scene.clusters for scene in scenes if scene.clusters is not None]
    count = max((each.means.shape[1] for each in clusters), default=0)
    padded = [
        replace(each, means=F.pad(each.means, (0, 0, 0, pad)), valid=F.pad(each.valid, (0, pad)))
        for each in clusters
        for pad in [count - each.means.shape[1]]
    ]
    stacked = Scene.cat([replace(scene, clusters=None) for scene in scenes])
    return replace(stacked, clusters=Clusters.cat(padded) if padded else None)
