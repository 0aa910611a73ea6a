"""Encoded scenes kept in memory and on disk, for trainings in which the backbone does not change."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch.nn.functional as F

from anystyle.caching import LRUCache
from anystyle.training.feature_store import FeatureStore
from anystyle.types import Clusters, Scene, Views


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
        return self._scenes.get(name, lambda: self._encoded(name, views.map(lambda tensor: tensor[row : row + 1])))

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
