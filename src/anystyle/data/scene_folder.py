"""Photographs of scenes in folders, with cameras where they are known."""

import json
import logging
from pathlib import Path

from PIL import Image

from anystyle.data.folder import common_size, image_files, nested_image_files
from anystyle.data.images import image_size, readable
from anystyle.data.poses import read_poses
from anystyle.data.stored import Shots, StoredScenes
from anystyle.errors import UserError
from anystyle.io.cache import LRUCache
from anystyle.io.documents import read_json
from anystyle.paths import inside, natural, short_names
from anystyle.ranges import AtLeastOne

logger = logging.getLogger(__name__)


class FolderScenes(StoredScenes):
    """Folders of photographs: one scene per folder, or ``root`` itself; also ScanNet++ and LLFF captures.

    A scene's photographs lie in its folder or in its sub-folder ``images``, where there may be a folder for each camera
    of a rig, and are taken in natural order. Cameras come from what a plugin of kind ``cameras`` reads, such as
    ``transforms.json`` or COLMAP's model, where there is one; photographs without a camera are then left out, and so
    are files that are not images; a damaged one raises when it is decoded. Every scene keeps its own aspect. The
    distortion of lenses is not undone, as in the published training.

    Args:
        root: A folder.
        images: Sub-folder with a scene's photographs, where there is one; ScanNet++ has undistorted ones in
            ``dslr/resized_undistorted_images``.
        cameras: File with a scene's cameras, or folder of COLMAP's model, below the scene's folder, such as ScanNet++'s
            ``dslr/nerfstudio/transforms_undistorted.json``; ``None`` looks for one.
        index: A JSON list of scene folders below ``root``, such as DL3DV's ``train_index.json``; ``None`` takes all.
        short_side: Shorter side of the views in pixels.
        multiple: Sides are multiples of it; ``None`` is the backbone's patch size.
    """

    def __init__(
        self,
        *,
        root: str = "scenes",
        images: str = "images",
        cameras: str | None = None,
        index: str | None = None,
        short_side: AtLeastOne = 448,
        multiple: AtLeastOne | None = None,
        patch_size: int = 14,
    ) -> None:
        multiple = patch_size if multiple is None else multiple
        self.root = Path(root)
        if not self.root.is_dir():
            raise UserError(f"root={root}: there is no such folder of scenes")
        self.images, self.cameras, self.short_side, self.multiple = images, cameras, short_side, multiple
        self.folders = self.found() if index is None else self._listed(self.root / index)
        if not self.folders:
            raise UserError(f"root={root}: no scene lies there; expected folders with photographs")
        self._cache: LRUCache[int, Shots] = LRUCache(256)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        frames = []
        (folder / "garden" / "images").mkdir(parents=True, exist_ok=True)
        for number in range(3):
            pose = [[1, 0, 0, 0.1 * number], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
            frames.append({"file_path": f"images/{number}.png", "transform_matrix": pose})
            Image.linear_gradient("L").resize((48, 36)).save(folder / "garden" / "images" / f"{number}.png")
        content = {"w": 48, "h": 36, "fl_x": 40.0, "fl_y": 40.0, "cx": 24.0, "cy": 18.0, "frames": frames}
        (folder / "garden" / "transforms.json").write_text(json.dumps(content))
        return {"root": str(folder), "short_side": 32, "multiple": 8}

    def __len__(self) -> int:
        return len(self.folders)

    def name(self, scene: int) -> str:
        folder = self._folder(scene)
        return self.root.resolve().name if folder == self.root else folder.relative_to(self.root).as_posix()

    def shots(self, scene: int) -> Shots:
        return self._cache.get(scene, lambda: self._read_shots(self._folder(scene)))

    def _folder(self, scene: int) -> Path:
        if not 0 <= scene < len(self.folders):
            raise UserError(f"scene {scene}: there are {len(self.folders)}, counted from 0")
        return self.folders[scene]

    def found(self) -> list[Path]:
        """The folders of the scenes, where no index names them."""
        if self._photographs(self.root):
            return [self.root]
        inside = (path for path in self.root.iterdir() if path.is_dir() and not path.name.startswith("."))
        return [path for path in sorted(inside, key=lambda path: natural(path.name)) if self._photographs(path)]

    def _listed(self, path: Path) -> list[Path]:
        folders: list[Path] = []
        for name in read_json(path, list[str], what="JSON list of folder names"):
            if (folder := inside(self.root, name)) is None:
                raise UserError(f"index={path} names {name!r:.200}, which lies outside of {self.root}")
            folders.append(folder)
        present = [folder for folder in folders if folder.is_dir()]
        if len(present) < len(folders):
            logger.warning("%d of %d scenes of %s are not there", len(folders) - len(present), len(folders), path)
        return present

    def _photographs(self, folder: Path) -> list[Path]:
        return nested_image_files(folder / self.images) if (folder / self.images).is_dir() else image_files(folder)

    def _read_shots(self, folder: Path) -> Shots:
        paths = self._photographs(folder)
        if not paths:
            raise UserError(f"there are no photographs in the scene {folder}")
        stored = read_poses(folder, paths, self.cameras)
        known = [path for path in paths if not stored or path in stored]
        if len(known) < len(paths):
            logger.warning("%d photographs of %s have no camera", len(paths) - len(known), folder)
        paths = readable(known)
        if not paths:
            raise UserError(f"none of the photographs of the scene {folder} can be read")
        size = common_size([image_size(path) for path in paths], short_side=self.short_side, multiple=self.multiple)
        names = short_names([path.with_suffix("") for path in paths])
        return Shots(paths, names, [stored[path] for path in paths] if stored else [], size)
