"""Scenes and styles from shards."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from anystyle.contracts import StoredCamera
from anystyle.data.folder import common_size
from anystyle.data.scene_folder import FolderScenes
from anystyle.data.stored import Shots, StoredScenes, StoredStyle, StoredStyles
from anystyle.data.style_folder import FolderStyles
from anystyle.ranges import AtLeastOne
from anystyle_datasets.packing import pack
from anystyle_datasets.shards import SceneSample, Shards, StyleSample


class ShardScenes(StoredScenes):
    """Scenes from shards that ``anystyle data shard`` wrote, in a folder or in object storage; read in parts.

    They are those of the source that was packed, bit for bit: the same scenes in the same order, the same views.

    Args:
        root: A folder, or its address: ``s3://bucket/folder``, ``https://...`` and others that fsspec knows.
        short_side: Shorter side of the views in pixels; ``None`` is that of the source.
        multiple: Sides are multiples of it; ``None`` is that of the source, or else the backbone's patch size.
    """

    def __init__(
        self,
        *,
        root: str = "shards/scenes",
        short_side: AtLeastOne | None = None,
        multiple: AtLeastOne | None = None,
        patch_size: int = 14,
    ) -> None:
        self.shards = Shards(root, "scenes")
        stored = self.shards.index.options
        self.short_side = short_side or stored.get("short_side") or 448
        self.multiple = multiple or stored.get("multiple") or patch_size

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        options = FolderScenes.example(folder / "photographs")
        pack(FolderScenes(**options), folder / "shards", options=options)  # pyright: ignore[reportArgumentType]
        return {"root": str(folder / "shards"), "short_side": 32, "multiple": 8}

    def __len__(self) -> int:
        return len(self.shards.index.names)

    def name(self, scene: int) -> str:
        return self.shards.name(scene)

    def num_views(self, scene: int) -> int:
        return self.shards.group(scene).size

    def shots(self, scene: int) -> Shots:
        return self.select(scene, range(self.num_views(scene)))

    def select(self, scene: int, views: Sequence[int]) -> Shots:
        rows = self.shards.group(scene)
        sizes = [(width, height) for width, height in rows[["width", "height"]].tolist() if width]
        samples = self.shards.read(rows[list(views)], SceneSample)
        return Shots(
            [picture or b"" for _, picture in samples],
            [about.name for about, _ in samples],
            [_camera(about) for about, _ in samples if about.world_from_camera is not None],
            common_size(sizes, short_side=self.short_side, multiple=self.multiple),
        )


def _camera(about: SceneSample) -> StoredCamera:
    return StoredCamera(np.array(about.world_from_camera), np.array(about.intrinsics), about.size or (1, 1))


class ShardStyles(StoredStyles):
    """Styles from shards that ``anystyle data shard`` wrote, in a folder or in object storage; read one by one.

    They are those of the source that was packed, bit for bit, in the same order.

    Args:
        root: A folder, or its address: ``s3://bucket/folder``, ``https://...`` and others that fsspec knows.
        size: Height and width in pixels; ``None`` is that of the source.
        crop: Which square of a picture is taken: the ``centre``, or a ``random`` one at every reading; ``None`` is as
            the source does.
    """

    def __init__(
        self,
        *,
        root: str = "shards/styles",
        size: AtLeastOne | None = None,
        crop: Literal["centre", "random"] | None = None,
    ) -> None:
        self.shards = Shards(root, "styles")
        stored = self.shards.index.options
        self.size = size or stored.get("size") or 256
        self.crop = crop or stored.get("crop") or "centre"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        (folder / "pictures").mkdir()
        options = FolderStyles.example(folder / "pictures")
        pack(FolderStyles(**options), folder / "shards", options=options)  # pyright: ignore[reportArgumentType]
        return {"root": str(folder / "shards")}

    def __len__(self) -> int:
        return len(self.shards.index.names)

    def stored(self, style: int) -> StoredStyle:
        ((about, picture),) = self.shards.read(self.shards.group(style), StyleSample)
        return StoredStyle(picture, about.text, about.name)
