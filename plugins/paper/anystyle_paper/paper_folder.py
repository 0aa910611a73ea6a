"""The folder of the paper's protocol: photographs, styles with texts, and the renders of any number of methods."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from anystyle.data.captions import captions_file, read_captions
from anystyle.data.folder import image_files
from anystyle.errors import UserError, listing
from anystyle.evaluation.names import Names, sequence, splits
from anystyle.evaluation.pairing import Gap, MissingImages
from anystyle.paths import folders_in, natural

SCENES = ("Train", "Truck", "M60", "Garden")
"""Three of Tanks and Temples, the last of Mip-NeRF 360."""
NUM_STYLES, NUM_FRAMES = 50, 16


@dataclass(frozen=True)
class PaperFolder:
    """A folder with everything that the paper's tables are computed from.

    ``content/SCENE/`` holds photographs, ``styles/`` or ``style_images/`` the style images with their captions, and
    ``methods/METHOD/SCENE/STYLE/`` what a method rendered; ``methods/METHOD/SCENE/STYLE_FRAME.png`` is read as well.
    Names of scenes are compared without case, styles by their name or by the number at its end. The images of a method
    belong to the photographs of their names, or, if others are among them, by their numbers to the n-th photograph. The
    first ``num_styles`` styles and ``frames`` photographs are judged.
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
        return {path.name: path for path in folders_in(self.root / "methods")}

    def photographs(self, scene: str) -> list[Path]:
        """The photographs of a scene that are judged; none where it is absent."""
        folder = _scene_folder(self.root / "content", scene)
        return _images(folder)[: self.frames] if folder else []

    def scene_folder_name(self, scene: str) -> str:
        """A scene's name as its folder of photographs has it."""
        folder = _scene_folder(self.root / "content", scene)
        return folder.name if folder else scene

    def renders(self, method: str) -> dict[tuple[str, str], dict[int, Path]]:
        """The images of a method by scene and style, those of the first photographs by the places of these."""
        by_cell: dict[tuple[str, str], dict[int, Path]] = {}
        styles = [path.stem for path in self.style_files]
        for scene in self.scene_names:
            folder, content = (_scene_folder(root, scene) for root in (self.methods[method], self.root / "content"))
            by_style = images_by_style(folder, styles) if folder else {}
            photographs = [path.stem for path in _images(content)] if content else []
            frames = sorted({frame for images in by_style.values() for frame in images}, key=natural)
            places = dict(zip(frames, _places(frames, photographs), strict=True))
            for style in styles:
                images = {places[frame]: path for frame, path in by_style.get(style, {}).items()}
                by_cell[scene, style] = {place: path for place, path in images.items() if place < self.frames}
        return by_cell

    def gaps(self, method: str) -> list[Gap]:
        """What a method lacks of the images that are judged."""
        names = {scene: [path.stem for path in self.photographs(scene)] for scene in self.scene_names}
        gaps = (
            Gap(
                scene, style, tuple(n for place, n in enumerate(names[scene]) if place not in images), len(names[scene])
            )
            for (scene, style), images in self.renders(method).items()
        )
        return [gap for gap in gaps if gap.frames]

    def problems(
        self, *, texts: bool = True, methods: Sequence[str] | None = None, missing: MissingImages = "refuse"
    ) -> list[str]:
        """A line for each thing that is missing.

        ``texts`` are looked for where they are needed, single images of methods unless they may be ``missing``.
        """
        lines = [
            f"content/{scene}: {count} photographs, fewer than {self.frames}"
            for scene in self.scene_names
            if (count := len(self.photographs(scene))) < self.frames
        ]
        if len(self.style_files) < self.num_styles:
            lines.append(f"styles: {len(self.style_files)} images, fewer than {self.num_styles}")
        captions = captions_file(self.styles)
        known = read_captions(captions) if texts and captions else {}
        without = [path.name for path in self.style_files if texts and not known.get(path.name, "").strip()]
        if without:
            lines.append(f"styles: no text for {len(without)} styles, such as {without[0]}")
        for method in self.methods if methods is None else methods:
            if method not in self.methods:
                lines.append(f"methods/{method}: there is no such folder")
            elif missing == "refuse" and (gaps := self.gaps(method)):
                short = [f"{gap.scene} in {gap.style} lacks {len(gap.frames)} of {gap.expected}" for gap in gaps]
                told = f"{len(gaps)} scenes lack images: {listing(short, 4)} (missing=allow judges the others)"
                lines.append(f"methods/{method}: {told}")
        return lines

    def require(self, *, texts: bool, methods: Sequence[str] | None, missing: MissingImages = "refuse") -> None:
        """Raise a UserError that says what is missing."""
        if lines := self.problems(texts=texts, methods=methods, missing=missing):
            raise UserError(
                f"root={self.root}: {'; '.join(lines)}; expected content/SCENE/FRAME.png, styles/STYLE.png "
                "with styles/captions.jsonl or style_descriptions.txt, methods/METHOD/SCENE/STYLE/FRAME.png "
                "(or STYLE_FRAME.png)"
            )


def _scene_folder(folder: Path, scene: str) -> Path | None:
    return next((path for path in folders_in(folder) if path.name.casefold() == scene.casefold()), None)


def _images(folder: Path) -> list[Path]:
    return image_files(folder / "images" if (folder / "images").is_dir() else folder)


def images_by_style(folder: Path, styles: Sequence[str]) -> dict[str, dict[str, Path]]:
    """Images of a scene by style and frame, in natural order: one folder per style, or ``STYLE_FRAME.png``."""
    inside = {path.name: path for path in folders_in(folder) if path.name != "images"}
    by_style: dict[str, dict[str, Path]] = {}
    for style in styles if inside else ():
        found = _meaning(style, inside)
        if len(found) > 1:
            raise UserError(f"{folder} has several folders of style {style}: {listing(found, 4)}; keep one of them")
        by_style[style] = {image.stem: image for name in found for image in image_files(inside[name])}
    for path in [] if inside else _images(folder):
        read = [(style, frame) for name, frame in splits(path.stem) for style in Names(styles).find(name)]
        name, _, frame = path.stem.rpartition("_")
        read = read or [(style, frame) for style in styles if _meaning(style, [name])]
        if len(read) > 1:
            typed = " or ".join(f"{style}/{frame}{path.suffix}" for style, frame in read)
            raise UserError(f"{path} may be of several styles; name it {typed} in that folder, and the others likewise")
        for style, frame in read:
            by_style.setdefault(style, {})[frame] = path
    return by_style


def _meaning(style: str, names: Collection[str]) -> list[str]:
    """The names that mean a style: its own, or those that end in its number, as Stylos' folders do."""
    numbers = {name: re.search(r"[0-9]+$", name) for name in names if style.isascii() and style.isdecimal()}
    return Names(names).find(style) or [
        name for name, number in numbers.items() if number and int(number[0]) == int(style)
    ]


def _places(frames: Sequence[str], photographs: Sequence[str]) -> Sequence[int]:
    """The places of the photographs that a method's frames belong to."""
    found = [Names(photographs).find(frame) for frame in frames]
    named = all(len(names) == 1 for names in found)
    return [photographs.index(name) for (name,) in found] if named else sequence(frames)
