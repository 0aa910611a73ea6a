"""Caches of scenes: decoded ones on the disk, encoded ones in memory and on the disk."""

import hashlib
import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
import torch.utils._pytree as pytree
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from anystyle.contracts import SceneSource
from anystyle.errors import UserError, one_line
from anystyle.io.atomic import atomic_path, write_json
from anystyle.io.cache import LRUCache
from anystyle.io.documents import kept_json
from anystyle.types import Attributes, Cameras, Clusters, Gaussians, Geometry, Scene, Tokens, Views

logger = logging.getLogger(__name__)


class CachedScenes(SceneSource):
    """A scene source whose scenes are read from another one once, and from a file of their own after that.

    Images are stored as bytes and depth in half precision; the first read gives the same rounded values as later ones.
    Processes may share a folder, which belongs to one source.
    """

    def __init__(self, source: SceneSource, folder: Path) -> None:
        self.source, self.folder = source, folder
        first = self._tensors(0)["images"]
        signature = [len(source), source.name(0), list(first.shape), int(first.sum())]
        known = kept_json(folder / "source.json", list[Any])
        if known is None:
            write_json(folder / "source.json", signature)
        elif known != signature:
            raise UserError(f"{folder} was made by another scene source; choose another cache or remove the folder")

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
        index = list(views)
        stored = {name: tensor[index].float()[None] for name, tensor in tensors.items()}
        images = stored["images"] / 255.0
        size = (images.shape[-2], images.shape[-1])
        return Views(images, Cameras(stored["poses"], stored["intrinsics"], size), depth=stored["depth"])

    def _tensors(self, scene: int) -> dict[str, Tensor]:
        views = self.source.read(scene, list(range(self.source.num_views(scene))))
        if views.cameras is None or views.depth is None:
            raise UserError("only scenes with cameras and depth can be cached; set cache=null")
        tensors = {
            "images": (views.images[0] * 255.0).round().to(torch.uint8),
            "depth": views.depth[0].half(),
            "poses": views.cameras.world_from_camera[0],
            "intrinsics": views.cameras.intrinsics[0],
        }
        return {name: tensor.contiguous() for name, tensor in tensors.items()}


class FeatureStore:
    """A folder with one file for each encoded scene, without its photographs, bit for bit.

    All that encoded scenes depend on is in ``description``: another one has another sub-folder. When that is full,
    further scenes are encoded each time they are seen, with one warning. Processes may share a folder.
    """

    def __init__(self, folder: Path, description: Mapping[str, Any], *, gigabytes: float) -> None:
        if gigabytes <= 0:
            raise UserError(f"features.gigabytes={gigabytes}: give the capacity of the folder, above 0")
        self.root, self.description, self.gigabytes = folder, description, gigabytes
        text = json.dumps(description, sort_keys=True)
        self.folder = folder / hashlib.sha256(text.encode()).hexdigest()[:16]
        self._full = False

    def described(self, **more: Any) -> "FeatureStore":
        """The store of scenes that depend on more."""
        return FeatureStore(self.root, {**self.description, **more}, gigabytes=self.gigabytes)

    @property
    def used(self) -> int:
        """Bytes that the encoded scenes occupy."""
        return sum(path.stat().st_size for path in self.folder.glob("*.pt"))

    def get(self, key: str, views: Views) -> Scene | None:
        """The scene of a key with the views it was encoded from, on their device; ``None`` if it is not stored."""
        path = self.folder / f"{key}.pt"
        if not path.is_file():
            return None
        try:
            known = [Scene, Attributes, Cameras, Clusters, Gaussians, Geometry, Tokens, Views]
            with torch.serialization.safe_globals(known):
                scene = torch.load(path, map_location=views.images.device, weights_only=True)
        except Exception as error:  # damaged archives raise nearly anything
            logger.warning("%s is damaged (%s); the scene is encoded again", path, one_line(error)[:200])
            return None
        return replace(scene, views=views)

    def put(self, key: str, scene: Scene) -> None:
        """Store a scene, if there is room."""
        if self._full:
            return
        # Cloned, because a view of a larger tensor would be written with all of it.
        stored = replace(scene, views=Views(scene.views.images[..., :0])).map(
            lambda tensor: tensor.detach().contiguous().clone()
        )
        size = sum(leaf.nbytes for leaf in pytree.tree_leaves(stored) if isinstance(leaf, Tensor))
        try:
            if self.used + size > self.gigabytes * 1e9:
                raise OSError("raise features.gigabytes or lower training.pool")
            with atomic_path(self.folder / f"{key}.pt") as temporary:
                torch.save(stored, temporary)
        except (OSError, RuntimeError) as error:
            self._full = True
            logger.warning("%s is full (%s); further scenes are encoded each time", self.folder, one_line(error))


class EncodedScenes:
    """Encoded scenes by their key and image size, least recently used first out; ``store`` keeps them on disk too.

    Every scene is encoded alone, whether or not it is cached: a batch is the same with and without the cache.
    """

    def __init__(self, encode: Callable[[Views], Scene], limit: int, store: FeatureStore | None = None) -> None:
        self.encode, self.store = encode, store
        self._scenes: LRUCache[str, Scene] = LRUCache(limit)

    def __call__(self, views: Views, keys: Sequence[int]) -> Scene:
        """The scenes of a batch of views, one key a row."""
        # The views of a key are the same each time, but their size may change from step to step.
        names = [f"{key}_{views.size[0]}x{views.size[1]}" for key in keys]
        return stack_scenes(
            [
                self._scenes.get(name, lambda name=name, row=row: self._encoded(name, views.row(row)))
                for row, name in enumerate(names)
            ]
        )

    def _encoded(self, name: str, views: Views) -> Scene:
        if self.store is None:
            return self.encode(views)
        scene = self.store.get(name, views)
        if scene is None:
            scene = self.encode(views)
            self.store.put(name, scene)
        return scene


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
