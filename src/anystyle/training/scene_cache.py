"""Encoded scenes, kept in memory and on the disk."""

import hashlib
import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from anystyle.caching import LRUCache
from anystyle.documents import parse_json
from anystyle.errors import one_line
from anystyle.io.atomic import atomic_path
from anystyle.types import Attributes as RawAttributes
from anystyle.types import Cameras, Clusters, Geometry, Scene, Tokens, Views

logger = logging.getLogger(__name__)

_VALUES = {kind.__name__: kind for kind in (Cameras, Clusters, Geometry, RawAttributes, Tokens)}
GIGABYTE = 1e9


@dataclass(frozen=True)
class FeatureFolder:
    """The folder of encoded scenes of a run, as far as its configuration describes them.

    Args:
        folder: Of all stores.
        gigabytes: Capacity of a store in 10^9 bytes.
        description: All that encoded scenes depend on: backbone, weights, scenes, precision.
    """

    folder: Path
    gigabytes: float
    description: Mapping[str, Any]

    def store(self, **more: Any) -> "FeatureStore":
        """The store of a training, with what its choice of views depends on added to the description."""
        return FeatureStore(self.folder, {**self.description, **more}, gigabytes=self.gigabytes)


class FeatureStore:
    """A folder with one file for each encoded scene, up to a stated size.

    The photographs themselves are not kept, for whoever asks has them. What is stored is what was computed, to the
    bit. When the folder is full, further scenes are encoded anew each time they are seen; this is said once.
    Processes may share a folder: a file is written whole, and two that write the same one write the same.

    Args:
        folder: Where the files go.
        description: All that the encoded scenes depend on; another description has another sub-folder.
        gigabytes: The most the sub-folder may hold, in 10^9 bytes.

    Raises:
        ValueError: The size is not positive.
    """

    def __init__(self, folder: str | Path, description: Mapping[str, Any], *, gigabytes: float) -> None:
        if gigabytes <= 0:
            raise ValueError(f"features.gigabytes={gigabytes}: give what the folder may hold, above 0")
        text = json.dumps(description, sort_keys=True, indent=2)
        self.folder = Path(folder) / hashlib.sha256(text.encode()).hexdigest()[:16]
        self.folder.mkdir(parents=True, exist_ok=True)
        self.limit = int(gigabytes * GIGABYTE)
        with atomic_path(self.folder / "description.json") as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")
        self._full = False

    @property
    def used(self) -> int:
        """Bytes that the encoded scenes take up now."""
        return sum(path.stat().st_size for path in self.folder.glob("*.safetensors"))

    def get(self, key: str, views: Views) -> Scene | None:
        """The scene of a key with the views it was encoded from, on their device; ``None`` if it is not kept."""
        path = self.folder / f"{key}.safetensors"
        if not path.is_file():
            return None
        try:
            with safe_open(path, framework="pt", device=str(views.images.device)) as file:
                layout = parse_json((file.metadata() or {})["scene"], dict[str, Any], source=str(path))
                parts = _joined(layout, file)
        except (SafetensorError, AttributeError, KeyError, TypeError, ValueError) as error:
            logger.warning("%s is damaged (%s); the scene is encoded again", path, error)
            return None
        return Scene(views=views, **parts)

    def put(self, key: str, scene: Scene) -> None:
        """Keep a scene, if there is room."""
        tensors: dict[str, Tensor] = {}
        parts = {item.name: getattr(scene, item.name) for item in fields(Scene) if item.name != "views"}
        layout = _split(parts, "", tensors)
        size = sum(tensor.numel() * tensor.element_size() for tensor in tensors.values())
        if self._full:
            return
        if self.used + size > self.limit:
            self._end(
                f"a scene takes {size / GIGABYTE:.2g} of the {self.limit / GIGABYTE:.3g} GB; raise features.gigabytes "
                f"or lower training.pool"
            )
            return
        try:
            with atomic_path(self.folder / f"{key}.safetensors") as temporary:
                save_file(tensors, temporary, metadata={"scene": json.dumps(layout)})
        except (OSError, SafetensorError) as error:
            self._end(f"the disk does not take more ({one_line(error)})")

    def _end(self, reason: str) -> None:
        self._full = True
        logger.warning(
            "%s holds %.2g GB, and %s; further scenes are encoded anew each time",
            self.folder, self.used / GIGABYTE, reason,
        )  # fmt: skip


def _split(value: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    """A nested value as JSON; its tensors are put into ``tensors`` under the paths of their keys."""
    if isinstance(value, Tensor):
        tensors[name] = value.detach().contiguous().clone()
        return {"tensor": name}
    if is_dataclass(value):
        parts = {item.name: getattr(value, item.name) for item in fields(value)}
        return {"value": type(value).__name__, "fields": _split(parts, name, tensors)}
    if isinstance(value, Mapping):
        return {"map": [[key, _split(part, f"{name}/{key}", tensors)] for key, part in value.items()]}
    return {"plain": list(value) if isinstance(value, tuple) else value}


def _joined(layout: Any, file: Any) -> Any:
    if "tensor" in layout:
        return file.get_tensor(layout["tensor"])
    if "map" in layout:
        return {key: _joined(part, file) for key, part in layout["map"]}
    if "value" in layout:
        return _VALUES[layout["value"]](**_joined(layout["fields"], file))
    plain = layout["plain"]
    return tuple(plain) if isinstance(plain, list) else plain


def without_stem(scene: Scene) -> Scene:
    """A scene for a branch that begins at the features: its stem, which nothing reads then, is empty."""
    return replace(scene, stem=scene.stem.with_data(torch.empty_like(scene.stem.data[:, :, :0])))


class EncodedScenes:
    """Scenes by the keys of what they show and their size, least recently used first out.

    Every scene is encoded alone, whether or not it stays: a batch is the same with and without the cache.

    Args:
        encode: Turns the views of one scene into a scene.
        limit: How many are kept in memory; 0 keeps none.
        store: Keeps them on disk too.
    """

    def __init__(self, encode: Callable[[Views], Scene], limit: int, store: FeatureStore | None = None) -> None:
        self.encode, self.store = encode, store
        self._scenes: LRUCache[str, Scene] = LRUCache(limit)

    def __call__(self, views: Views, keys: Sequence[int]) -> Scene:
        """The scenes of a batch of views, one key a row."""
        return stack_scenes([self._one(views, row, key) for row, key in enumerate(keys)])

    def _one(self, views: Views, row: int, key: int) -> Scene:
        # A pool's views are the same each time, and yet of another size where sizes change from step to step.
        name = f"{key}_{views.size[0]}x{views.size[1]}"
        return self._scenes.get(name, lambda: self._encoded(name, views.row(row)))

    def _encoded(self, name: str, views: Views) -> Scene:
        scene = None if self.store is None else self.store.get(name, views)
        if scene is None:
            scene = self.encode(views)
            if self.store is not None:
                self.store.put(name, scene)
        return scene


def stack_scenes(scenes: Sequence[Scene]) -> Scene:
    """One batch of scenes of equal shapes; clusters are padded to one count."""
    if len(scenes) == 1:
        return scenes[0]
    clusters = [scene.clusters for scene in scenes if scene.clusters is not None]
    stacked = Scene.cat([replace(scene, clusters=None) for scene in scenes])
    return replace(stacked, clusters=Clusters.cat(_padded(clusters)) if clusters else None)


def _padded(clusters: Sequence[Clusters]) -> list[Clusters]:
    most = max(one.means.shape[1] for one in clusters)
    missing = [most - one.means.shape[1] for one in clusters]
    return [
        replace(one, means=F.pad(one.means, (0, 0, 0, count)), valid=F.pad(one.valid, (0, count)))
        for one, count in zip(clusters, missing, strict=True)
    ]
