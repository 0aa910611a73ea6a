"""The folder of the paper's protocol: photographs, styles with texts, and the renders of any number of methods."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from anystyle.data.captions import captions_file, read_captions
from anystyle.data.folder import image_files
from anystyle.errors import UserError
from anystyle.paths import natural

SCENES = ("Train", "Truck", "M60", "Garden")
"""Three of Tanks and Temples, the last of Mip-NeRF 360."""

NUM_STYLES = 50
NUM_FRAMES = 16

_DESCRIPTION = (
    "expected content/SCENE/FRAME.png, styles/STYLE.png with styles/captions.jsonl or style_descriptions.txt, "
    "methods/METHOD/SCENE/STYLE/FRAME.png (or STYLE_FRAME.png)"
)


@dataclass(frozen=True)
class PaperFolder:
    """A folder with everything that the paper's tables are computed from.

    ``content/SCENE/`` holds photographs, ``styles/`` or ``style_images/`` the style images with their captions, and
    ``methods/METHOD/SCENE/STYLE/`` what a method rendered; ``methods/METHOD/SCENE/STYLE_FRAME.png`` is read as well.
    Names of scenes are compared without case, styles by their name or by the number at its end, and the n-th image of a
    method belongs to the n-th photograph. The first ``num_styles`` styles and ``frames`` photographs are judged.
    """

    root: Path
    scene_names: tuple[str, ...] = SCENES
    num_styles: int = NUM_STYLES
    frames: int = NUM_FRAMES

    @cached_property
    def styles(self) -> Path:
        """The folder of style images."""
        published = self.root / "style_images"
        return published if published.is_dir() else self.root / "styles"

    @cached_property
    def style_files(self) -> list[Path]:
        """The style images that are used, in natural order."""
        return image_files(self.styles)[: self.num_styles] if self.styles.is_dir() else []

    @cached_property
    def methods(self) -> dict[str, Path]:
        """The folders of methods, by name."""
        return {path.name: path for path in _folders(self.root / "methods")}

    def photographs(self, scene: str) -> list[Path]:
        """The photographs of a scene that are judged; none where it is absent."""
        folder = _scene_folder(self.root / "content", scene)
        return _images(folder)[: self.frames] if folder else []

    def scene_folder_name(self, scene: str) -> str:
        """A scene's name as its folder of photographs has it."""
        folder = _scene_folder(self.root / "content", scene)
        return folder.name if folder else scene

    def renders(self, method: str) -> dict[tuple[str, str], list[Path]]:
        """The images of a method by scene and style, the first frames of each."""
        by_cell: dict[tuple[str, str], list[Path]] = {}
        for scene in self.scene_names:
            folder = _scene_folder(self.methods[method], scene)
            by_style = images_by_style(folder) if folder else {}
            for path in self.style_files:
                images = next((images for name, images in by_style.items() if _same_style(name, path.stem)), [])
                by_cell[scene, path.stem] = images[: self.frames]
        return by_cell

    def problems(self, *, texts: bool = True, methods: Sequence[str] | None = None) -> list[str]:
        """A line for each thing that is missing; ``texts`` are looked for where they are needed."""
        missing = [
            f"content/{scene}: {count} photographs, fewer than {self.frames}"
            for scene in self.scene_names
            if (count := len(self.photographs(scene))) < self.frames
        ]
        if len(self.style_files) < self.num_styles:
            missing.append(f"styles: {len(self.style_files)} images, fewer than {self.num_styles}")
        captions = captions_file(self.styles)
        known = read_captions(captions) if texts and captions else {}
        without = [path.name for path in self.style_files if texts and not known.get(path.name, "").strip()]
        if without:
            missing.append(f"styles: no text for {len(without)} styles, such as {without[0]}")
        for method in self.methods if methods is None else methods:
            if method not in self.methods:
                missing.append(f"methods/{method}: there is no such folder")
                continue
            if short := [cell for cell, paths in self.renders(method).items() if len(paths) < self.frames]:
                missing.append(f"methods/{method}: {len(short)} scenes lack images: {' in '.join(short[0])}, …")
        return missing

    def require(self, *, texts: bool, methods: Sequence[str] | None) -> None:
        """Raise a UserError that says what is missing."""
        if missing := self.problems(texts=texts, methods=methods):
            more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
            raise UserError(f"root={self.root}: {'; '.join(missing[:3])}{more}; {_DESCRIPTION}")


def _folders(folder: Path) -> list[Path]:
    folders = (path for path in folder.glob("[!.]*") if path.is_dir())
    return sorted(folders, key=lambda path: natural(path.name))


def _scene_folder(folder: Path, scene: str) -> Path | None:
    return next((path for path in _folders(folder) if path.name.casefold() == scene.casefold()), None)


def _images(folder: Path) -> list[Path]:
    return image_files(folder / "images" if (folder / "images").is_dir() else folder)


def images_by_style(folder: Path) -> dict[str, list[Path]]:
    """Images of a scene by style, in natural order of their frames: one folder a style, or ``STYLE_FRAME.png``."""
    if inside := [path for path in _folders(folder) if path.name != "images"]:
        return {path.name: image_files(path) for path in inside}
    by_style: dict[str, list[Path]] = {}
    for path in _images(folder):
        by_style.setdefault(path.stem.rpartition("_")[0], []).append(path)
    return by_style


def _same_style(name: str, style: str) -> bool:
    # Stylos' folder of style 07 has a name that ends in this number.
    number = re.search(r"\d+$", name)
    return name == style or bool(number and style.isdecimal() and int(number[0]) == int(style))
