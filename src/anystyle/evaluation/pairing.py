"""Frame pairing: which photograph and which style each stylized image of three folders belongs to."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from anystyle.data.images import SUFFIXES, listing
from anystyle.errors import UserError
from anystyle.paths import natural

log = logging.getLogger(__name__)

CAMERAS = "cameras.npz"

Files = dict[tuple[str, str], Path]
"""Files by scene and stem."""


@dataclass(frozen=True)
class Cell:
    """The stylized images of one scene in one style, in order of their frames; ``reference`` is the style image.

    The scene's name is empty where the images lie in one flat folder.
    """

    scene: str
    style: str
    frames: tuple[str, ...]
    content: tuple[Path, ...]
    stylized: tuple[Path, ...]
    reference: Path
    depth: tuple[Path, ...] = ()
    cameras: Path | None = None

    def pictures(self) -> dict[str, Path]:
        """The middle frame with its photograph and style, as an evaluation's row shows them."""
        middle = len(self.frames) // 2
        return {"photograph": self.content[middle], "style": self.reference, "result": self.stylized[middle]}


@dataclass(frozen=True)
class Pairing:
    """Every scene in every style, and the photographs and style images that no stylized image belongs to."""

    cells: tuple[Cell, ...]
    unused: tuple[str, ...] = ()

    def scenes(self) -> dict[str, list[Cell]]:
        """The cells of each scene."""
        scenes: dict[str, list[Cell]] = {}
        for cell in self.cells:
            scenes.setdefault(cell.scene, []).append(cell)
        return scenes


def pair(content: Path, style: Path, stylized: Path, depth: Path | None = None) -> Pairing:
    """Find the photograph and the style of each stylized image.

    Stylized images are ``SCENE/STYLE_FRAME.png`` or ``SCENE/STYLE/FRAME.png``, or ``STYLE_FRAME.png`` for one scene.
    Photographs are ``SCENE/FRAME.png`` (or ``FRAME.png``), styles ``STYLE.png``; either may also have the stylized
    image's own name, as published evaluations write them. Numbers are compared as numbers: frame ``3`` is frame
    ``003``. Depth, along z, is ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` beside it where cameras are known.
    """
    results = _files(stylized, "stylized", SUFFIXES)
    photographs, references = _files(content, "content", SUFFIXES), _files(style, "style", SUFFIXES)
    depths = {} if depth is None else _files(depth, "depth", frozenset({".npy"}))
    by_content, by_style, by_depth = (
        {(scene, _key(stem)): path for (scene, stem), path in files.items()}
        for files in (photographs, references, depths)
    )
    matches: dict[tuple[str, str], list[tuple[str, Path, Path, Path, Path | None]]] = {}
    unmatched: list[str] = []
    used: set[Path] = set()
    for (scene, stem), path in results.items():
        name, _, frame = stem.rpartition("_")
        name, frame = (name, frame) if name else (stem, stem)
        # The stylized image's own name comes first: three equal names are unambiguous.
        photograph, reference = _lookup(by_content, scene, (stem, frame)), _lookup(by_style, scene, (stem, name))
        depth_map = _lookup(by_depth, scene, (frame, stem))
        if photograph is not None and reference is not None and (depth_map is not None or not depths):
            matches.setdefault((scene, name), []).append((frame, photograph, path, reference, depth_map))
            used |= {photograph, reference}
            continue
        missing = [f"no content {frame}"] * (photograph is None) + [f"no style {name}"] * (reference is None)
        unmatched.append(f"{scene}/{stem} ({', '.join(missing) or f'no depth {frame}'})".lstrip("/"))
    if unmatched:
        raise UserError(f"{len(unmatched)} of {len(results)} stylized images have no partner: {listing(unmatched, 8)}")
    unused = tuple(
        f"{root.name}/{path.relative_to(root).as_posix()}"
        for root, files in ((content, photographs), (style, references))
        for path in files.values()
        if path not in used
    )
    if unused:
        log.warning("%d images belong to no stylized image: %s", len(unused), listing(unused, 8))
    cells: list[Cell] = []
    for scene, name in sorted(matches, key=lambda key: (natural(key[0]), natural(key[1]))):
        rows = sorted(matches[scene, name], key=lambda row: natural(row[0]))
        frames, shown, images, styles, maps = zip(*rows, strict=True)
        cameras = None if depth is None else depth / scene / CAMERAS
        cameras = cameras if cameras is not None and cameras.is_file() else None
        cells.append(Cell(scene, name, frames, shown, images, styles[0], maps if depths else (), cameras))
    return Pairing(tuple(cells), unused)


def _files(folder: Path, what: str, suffixes: frozenset[str]) -> Files:
    """Files by scene and stem, in natural order; ``SCENE/STYLE/FRAME.png`` has the stem ``STYLE_FRAME``."""
    if not folder.is_dir():
        raise UserError(f"there is no {what} folder {folder}")
    patterns = ("*", "*/*", "*/images/*", "*/*/*", "*/images/*/*") if what == "stylized" else ("*", "*/*", "*/images/*")
    paths = {path for pattern in patterns for path in folder.glob(pattern)}
    files: Files = {}
    for path in sorted(paths, key=lambda path: natural(path.relative_to(folder).as_posix())):
        parts = path.relative_to(folder).parts
        if path.suffix.lower() not in suffixes or any(part.startswith(".") for part in parts) or not path.is_file():
            continue
        if len(parts) > 1 and parts[1] != "images" and (folder / parts[0] / "images").is_dir():
            continue
        scene, *inner = [part for part in parts[:-1] if part != "images"] or [""]
        key = (scene, "_".join([*inner, path.stem]))
        if key in files:
            raise UserError(f"{files[key]} and {path} are the same image of the {what} folder; keep one of them")
        files[key] = path
    if not files:
        raise UserError(f"the {what} folder {folder} holds no {'depth (.npy)' if what == 'depth' else 'image'}")
    return files


def _key(name: str) -> str:
    return str(int(name)) if name.isascii() and name.isdecimal() and len(name) < 10 else name


def _lookup(files: Files, scene: str, names: Sequence[str]) -> Path | None:
    """The first file of one of these names, in the scene's own folder or in none."""
    keys = [(folder, _key(name)) for name in names for folder in (scene, "")]
    return next((files[key] for key in keys if key in files), None)
