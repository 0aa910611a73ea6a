"""Encoded scenes kept in memory and on disk, for trainings in which the backbone does not change."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.training.feature_store import FeatureStore
from anystyle.types import Clusters, Scene, Value, Views


class EncodedScenes:
    """Scenes by the keys of what they show and their size, least recently used first out.

    Every scene is encoded alone, whether or not it stays: a batch is the same with and without the cache.

    Args:
        encode: Turns the views of one scene into a scene.
        limit: How many are kept in memory; 0 keeps none.
        store: Keeps them on disk too.
    """

    def __init__(self, encode: Callable[[Views], Scene], limit: int, store: FeatureStore | None = None) -> None:
        self.encode, self.limit, self.store = encode, limit, store
        self._kept: OrderedDict[str, Scene] = OrderedDict()

    def __call__(self, views: Views, keys: Sequence[int]) -> Scene:
        """The scenes of a batch of views, one key a row."""
        return stack_scenes([self._one(views, row, key) for row, key in enumerate(keys)])

    def _one(self, views: Views, row: int, key: int) -> Scene:
        # A pool's views are the same each time, and yet of another size where sizes change from step to step.
        name = f"{key}_{views.size[0]}x{views.size[1]}"
        if name in self._kept:
            self._kept.move_to_end(name)
            return self._kept[name]
        alone = views.map(lambda tensor: tensor[row : row + 1])
        scene = None if self.store is None else self.store.get(name, alone)
        if scene is None:
            scene = self.encode(alone)
            if self.store is not None:
                self.store.put(name, scene)
        if self.limit:
            self._kept[name] = scene
            while len(self._kept) > self.limit:
                self._kept.popitem(last=False)
        return scene


def stack_scenes(scenes: Sequence[Scene]) -> Scene:
    """One batch of scenes of equal shapes; clusters are padded to one count."""
    if len(scenes) == 1:
        return scenes[0]
    clusters = [scene.clusters for scene in scenes if scene.clusters is not None]
    stacked = {
        item.name: _stacked([getattr(scene, item.name) for scene in scenes])
        for item in fields(Scene)
        if item.name != "clusters"
    }
    return Scene(**stacked, clusters=_padded(clusters) if clusters else None)


def _stacked(values: Sequence[Any]) -> Any:
    first = values[0]
    if isinstance(first, Tensor):
        return torch.cat(list(values))
    if isinstance(first, Value) and is_dataclass(first):
        return type(first)(**{item.name: _stacked([getattr(v, item.name) for v in values]) for item in fields(first)})
    if isinstance(first, dict):
        return {key: _stacked([value[key] for value in values]) for key in first}
    return first


def _padded(clusters: Sequence[Clusters]) -> Clusters:
    count = max(one.means.shape[1] for one in clusters)
    return Clusters(
        index=torch.cat([one.index for one in clusters]),
        weight=torch.cat([one.weight for one in clusters]),
        means=torch.cat([F.pad(one.means, (0, 0, 0, count - one.means.shape[1])) for one in clusters]),
        valid=torch.cat([F.pad(one.valid, (0, count - one.valid.shape[1])) for one in clusters]),
    )
