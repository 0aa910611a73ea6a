"""Results, photographs and styles in folders, and their pictures in one size."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from PIL import Image, ImageOps

from anystyle.errors import UserError
from anystyle.evaluation.names import folded
from anystyle.paths import natural

log = logging.getLogger(__name__)
_T = TypeVar("_T")

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")

ResultPaths = Mapping[tuple[str, str], Sequence[Path]]
"""One method's frames of each scene and style, in order."""


def frames_in(path: Path) -> list[Path]:
    """The images of a file or a folder, or of the folder ``renders`` or ``images`` in it, sorted by name."""
    inner = next((path / name for name in ("renders", "images") if (path / name).is_dir()), path)
    files = (file for file in (inner.iterdir() if inner.is_dir() else [path]) if file.is_file())
    return sorted((file for file in files if file.suffix.lower() in SUFFIXES), key=lambda file: natural(file.name))


def _entries(folder: Path, kind: str) -> list[Path]:
    """What lies in a folder, hidden entries aside."""
    if not folder.is_dir():
        raise UserError(f"{kind} {folder} is not a folder")
    return [entry for entry in sorted(folder.iterdir()) if not entry.name.startswith(".")]


def frames_by_name(folder: Path, kind: str) -> dict[str, list[Path]]:
    """Images laid out as ``NAME.jpg`` or ``NAME/FRAMES``, by name; ``kind`` names the folder in errors."""
    entries = [(entry, frames_in(entry)) for entry in _entries(folder, kind)]
    return {entry.stem if entry.is_file() else entry.name: frames for entry, frames in entries if frames}


def find_results(method: str, folder: Path) -> ResultPaths:
    """Results laid out as ``SCENE/STYLE.png`` or ``SCENE/STYLE/FRAMES``."""
    scenes = [path for path in _entries(folder, f"method {method}:") if path.is_dir()]
    found = {(path.name, style): of for path in scenes for style, of in frames_by_name(path, "scene").items()}
    if not found:
        raise UserError(f"method {method}: {folder} holds no results; expected SCENE/STYLE.png or SCENE/STYLE/*.png")
    return found


def find_styles(folder: Path) -> dict[str, Path]:
    """Styles laid out as ``STYLE.jpg``, or ``STYLE.txt`` for a style in words, by name."""
    files = [file for file in _entries(folder, "styles") if file.is_file()]
    return {file.stem: file for file in files if file.suffix.lower() in (*SUFFIXES, ".txt")}


def matching_frames(groups: Sequence[Sequence[Path]], count: int) -> list[list[Path]]:
    """``count`` evenly spaced frames of each group, of the names that all groups share if there are enough."""
    few = min(groups, key=len)
    if len(few) < count:
        raise UserError(f"{few[0].parent} has {len(few)} view(s) where {count} are planned; add some or plan fewer")
    named = [{folded(frame.stem): frame for frame in group} for group in groups]
    common = [name for name in named[0] if all(name in frames for frames in named)]
    if len(common) >= count:
        names = spread(common, count)
        return [[frames[name] for name in names] for frames in named]
    if len({len(group) for group in groups}) > 1:
        numbers = ", ".join(f"{len(group)} in {group[0].parent}" for group in groups)
        log.warning("views have different names and numbers (%s): they are matched by their places", numbers)
    return [spread(group, count) for group in groups]


def spread(entries: Sequence[_T], count: int) -> list[_T]:
    """``count`` evenly spaced entries, the middle one for 1; all where there are fewer."""
    count = min(count, len(entries))
    return [entries[(2 * index + 1) * len(entries) // (2 * count)] for index in range(count)]


def read_picture(path: Path) -> Image.Image:
    """An image as RGB, upright, transparency over white, without any metadata."""
    from anystyle.data.images import open_image  # with torch, whose import takes seconds

    return Image.fromarray(np.asarray(open_image(path)))


def fitted_size(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Width and height with the same proportions and ``longest`` as the longer side."""
    scale = longest / max(size)
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))


def degraded(image: Image.Image) -> Image.Image:
    """A gray copy, blurred to a sixteenth of the resolution."""
    small = ImageOps.grayscale(image).resize((max(1, image.width // 16), max(1, image.height // 16)))
    return small.resize(image.size, Image.Resampling.BICUBIC).convert("RGB")
