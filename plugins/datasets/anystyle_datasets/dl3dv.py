"""DL3DV-10K, as its archives unpack."""

import json
import logging
import os
from pathlib import Path

from anystyle.data.folder import image_files
from anystyle.data.scene_folder import FolderScenes
from anystyle.io.documents import read_json
from anystyle.ranges import AtLeastOne

logger = logging.getLogger(__name__)

TRAIN_INDEX, TEST_INDEX = "train_index.json", "test_index.json"


class DL3DVScenes(FolderScenes):
    """DL3DV-10K as it is downloaded: at 480P, 480 x 270 pixels, not resized, since training draws a size per step.

    ``root`` has the folders of the batches, ``1K`` to ``11K``, in which a folder for each scene holds
    ``transforms.json`` and the photographs.

    Args:
        root: A folder.
        images: Sub-folder with a scene's photographs: ``images_8`` of 480P, ``images_4`` of 960P.
        cameras: File with a scene's cameras below its folder; ``None`` looks for one.
        index: A JSON list of scene folders below ``root``; ``None`` takes ``train_index.json`` where there is one, and
            otherwise all scenes, at any depth, that ``test_index.json`` does not list.
        short_side: Shorter side of the views in pixels.
        multiple: Sides are multiples of it; ``None`` is the backbone's patch size.
    """

    def __init__(
        self,
        *,
        root: str = "DL3DV-10K",
        images: str = "images_8",
        cameras: str | None = None,
        index: str | None = None,
        short_side: AtLeastOne = 270,
        multiple: AtLeastOne | None = 1,
        patch_size: int = 14,
    ) -> None:
        if index is None and (Path(root) / TRAIN_INDEX).is_file():
            index = TRAIN_INDEX
        super().__init__(
            root=root,
            images=images,
            cameras=cameras,
            index=index,
            short_side=short_side,
            multiple=multiple,
            patch_size=patch_size,
        )

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        options = super().example(folder)
        scene = folder / "1K" / "0a1b"
        scene.parent.mkdir(exist_ok=True)
        (folder / "garden").rename(scene)
        (scene / "images").rename(scene / "images_8")
        (folder / TEST_INDEX).write_text(json.dumps(["2K/9f8e"]))
        return options

    def found(self) -> list[Path]:
        listed = self.root / TEST_INDEX
        tests = read_json(listed, list[str], what="JSON list of folder names") if listed.is_file() else []
        scenes: list[Path] = []
        for folder, inside, files in os.walk(self.root):
            path = Path(folder)
            if packed := [name for name in files if name.endswith(".zip") and name.removesuffix(".zip") not in inside]:
                logger.warning("%s has %d archives that are not unpacked, such as %s", path, len(packed), packed[0])
            if self.images in inside and image_files(path / self.images):
                scenes.append(path)
                inside.clear()  # what lies below a scene belongs to it
        return sorted(path for path in scenes if path.relative_to(self.root).as_posix() not in tests)
