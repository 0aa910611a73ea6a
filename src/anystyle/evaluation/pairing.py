"""Frame pairing: which photograph and which style each stylized image of three folders belongs to."""

import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal, NamedTuple

from anystyle.data.images import SUFFIXES
from anystyle.errors import UserError, listing
from anystyle.evaluation.layout import DEFAULTS, Meaning, ResultLayout
from anystyle.evaluation.names import Names, sequence
from anystyle.paths import folders_in, natural

CAMERAS = "cameras.npz"

Files = dict[str, Path]
"""Files by their names without suffix, in natural order."""

MissingImages = Literal["refuse", "allow"]


@dataclass(frozen=True)
class StylizedImages:
    """The stylized images of one scene in one style, in order of their frames; ``reference`` is the style image.

    The scene's name is empty where the images lie in one flat folder. ``numbers`` are those of the frames in the
    sequence of the photographs, one after the other if empty. There is no depth for a frame where it is ``None``.
    """

    scene: str
    style: str
    frames: tuple[str, ...]
    content: tuple[Path, ...]
    stylized: tuple[Path, ...]
    reference: Path
    depth: tuple[Path | None, ...] = ()
    cameras: Path | None = None
    numbers: tuple[int, ...] = ()

    def pictures(self) -> dict[str, Path]:
        """The middle frame with its photograph and style, as an evaluation's row shows them."""
        middle = len(self.frames) // 2
        return {"photograph": self.content[middle], "style": self.reference, "result": self.stylized[middle]}


class Gap(NamedTuple):
    """The frames of one scene in one style that are not there, of ``expected``."""

    scene: str
    style: str
    frames: tuple[str, ...]
    expected: int

    def __str__(self) -> str:
        where = f"{self.scene}/{self.style}".lstrip("/")
        if len(self.frames) == self.expected:
            return f"{where} (all {self.expected})"
        return f"{where} ({len(self.frames)} of {self.expected}: {listing(self.frames, 4)})"


@dataclass(frozen=True)
class Pairing:
    """Every scene in every style that has images, and what is missing of those that photographs and styles imply."""

    cells: tuple[StylizedImages, ...]
    missing: tuple[Gap, ...] = ()

    def chosen(self, scenes: Collection[str], styles: Collection[str]) -> "Pairing":
        """What concerns some of the scenes and styles."""
        keys = set(product(scenes, styles))
        cells = tuple(cell for cell in self.cells if (cell.scene, cell.style) in keys)
        return Pairing(cells, tuple(gap for gap in self.missing if (gap.scene, gap.style) in keys))

    def lacking(self) -> str:
        """What is missing, and of how many, in one line; empty if nothing is."""
        return "; ".join(filter(None, (self._images() if self.missing else "", *self._geometry())))

    def require(self) -> None:
        """Raise a UserError that names what is missing."""
        if told := self.lacking():
            raise UserError(f"{told}; add them, or missing=allow to judge what is there")

    def refuse_numbered_anew(self) -> None:
        """Raise a UserError where results numbered from the start may be of other views than the first photographs."""
        for scene in {gap.scene for gap in self.missing}:
            given = {frame for cell in self.cells if cell.scene == scene for frame in cell.frames}
            absent = {frame for gap in self.missing if gap.scene == scene for frame in gap.frames} - given
            last = {frame: int(found[-1]) for frame in given | absent if (found := re.findall("[0-9]+", frame))}
            numbers, others = (sorted(last.get(frame, -1) for frame in frames) for frames in (given, absent))
            if not (numbers and others) or others[0] <= numbers[-1]:
                continue
            if 0 <= numbers[0] <= 1 and numbers[-1] - numbers[0] < len(numbers):
                counted = f"{len(given)} of {len(given | absent)} views of {scene or 'the scene'}"
                raise UserError(
                    f"the results of {counted} are numbered {numbers[0]} to {numbers[-1]}: these may be the first "
                    "photographs, or others, such as every eighth, numbered anew; name them by their photographs, or "
                    "give --content a folder of those photographs alone"
                )

    def _images(self) -> str:
        count = sum(len(gap.frames) for gap in self.missing)
        expected = count + sum(len(cell.frames) for cell in self.cells)
        scenes, styles = ({getattr(cell, name) for cell in self.cells} for name in ("scene", "style"))
        whole: Counter[str] = Counter()
        parts: list[str] = []
        for gap in self.missing:
            if gap.scene not in scenes:
                whole[f"scene {gap.scene}"] += gap.expected
            elif gap.style not in styles:
                whole[f"style {gap.style}"] += gap.expected
            else:
                parts.append(str(gap))
        named = [*(f"{name} (all {whole[name]})" for name in sorted(whole, key=natural)), *parts]
        return f"{count} of {expected} stylized images are missing: {listing(named, 8)}"

    def _geometry(self) -> Iterator[str]:
        """What is missing of the depth and the cameras that other frames and scenes have."""
        maps = {
            f"{cell.scene}/{frame}".lstrip("/")
            for cell in self.cells
            for frame, depth in zip(cell.frames, cell.depth or [None] * len(cell.frames), strict=True)
            if depth is None
        }
        if maps and any(cell.depth for cell in self.cells):
            yield f"depth is missing of {listing(sorted(maps, key=natural), 8)}"
        with_cameras = {cell.scene: cell.cameras is not None for cell in self.cells}
        if any(with_cameras.values()) and (absent := [scene for scene, known in with_cameras.items() if not known]):
            yield f"{CAMERAS} is missing of {listing(absent, 8)}"


def pair(
    content: Path,
    style: Path,
    stylized: Path,
    depth: Path | None = None,
    *,
    layout: str | None = None,
    missing: MissingImages = "refuse",
) -> Pairing:
    """Find the photograph and the style of each stylized image.

    Photographs are ``SCENE/FRAME.png`` or ``SCENE/images/FRAME.png``, of one scene also ``FRAME.png``; styles are
    ``STYLE.png``. Depth, along z, is ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` beside it where cameras are known.
    Names are found whole, as :class:`~anystyle.evaluation.names.Names` does: frame ``3`` is frame ``003``.

    Args:
        content: A folder, as are the next ones.
        style: Style images.
        stylized: Results.
        depth: Maps, where depth is known.
        layout: How results are named, as :class:`~anystyle.evaluation.layout.ResultLayout` reads it; images that are
            named otherwise are no results. ``None`` takes that of :data:`~anystyle.evaluation.layout.DEFAULTS` which
            fits most of them.
        missing: ``refuse`` raises where photographs, styles and depth imply more images than there are; ``allow`` pairs
            those that are there.

    Raises:
        UserError: A folder is missing, no image is named as the layout says, or one has no partner or several.
    """
    photographs, styles, results = _photographs(content), _files(style, "style"), _files(stylized, "stylized", "**/*")
    for what, folder, files, expected in (
        ("content", content, photographs, "SCENE/FRAME.png"),
        ("style", style, styles, "STYLE.png"),
        ("stylized", stylized, results, f"{DEFAULTS[0]}.png"),
    ):
        if not files:
            raise UserError(f"the {what} folder {folder} holds no image; expected {expected}")
    candidates = {text: _scenes(photographs, text) for text in ([layout] if layout is not None else DEFAULTS)}
    if layout is None:
        usual = ((text, scenes) for text, scenes in candidates.items() if scenes)
        candidates = {text: scenes for text, scenes in usual if "{scene}" in text or len(scenes) == 1}
    readers = [ResultLayout(text, scenes, styles) for text, scenes in candidates.items()]
    meanings = [{path: reader.meanings(path) for path in results} for reader in readers]
    fits = [sum(map(bool, meant.values())) for meant in meanings]
    best = fits.index(max(fits))
    if not fits[best]:
        example = min(results, key=lambda path: "gt" in path.split("/"))  # other programs put the photographs there
        raise UserError(_no_layout(stylized, example, readers))
    reader, found, unmatched = readers[best], dict[Meaning, Path](), list[str]()
    for path, meant in meanings[best].items():
        if len(meant) > 1:
            typed = " or ".join(map("/".join, meant))
            raise UserError(f"{path} may be {typed}; name it so, and the others likewise")
        if meant and found.setdefault(meant[0], results[path]) != results[path]:
            raise UserError(f"{found[meant[0]]} and {results[path]} are the same image; keep one of them")
        reason = reader.reason(path)
        if not meant and (reason or layout is None):
            unmatched.append(f"{path} ({reason or 'named otherwise'})")
    if unmatched:
        told = f"{len(unmatched)} of {len(found) + len(unmatched)} stylized images have no partner"
        raise UserError(f"{told}: {listing(unmatched, 8)}; they are read as {reader.text}")
    pairing = _pairing(candidates[reader.text], styles, found, depth)
    if missing == "refuse":
        pairing.require()
    return pairing


def _no_layout(stylized: Path, path: str, readers: Sequence[ResultLayout]) -> str:
    """That no result is named as expected, and the layout to type."""
    told = f"no image in {stylized} is named {' or '.join(reader.text for reader in readers)}"
    if layout := next(filter(None, (reader.of(path) for reader in readers)), None):
        return f"{told}; give --layout '{layout}'"
    examples = ", ".join(f"{field} {names[0]!r}" for field, names in readers[0].known.items())
    return f"{told}; give the --layout of names such as {path!r}, where there is {examples}"


def _pairing(scenes: Mapping[str, Files], styles: Files, found: Mapping[Meaning, Path], depth: Path | None) -> Pairing:
    """Every scene in every style in order, and the gaps between the images that are there."""
    cells: list[StylizedImages] = []
    gaps: list[Gap] = []
    for scene, photographs in scenes.items():
        numbers = dict(zip(photographs, sequence(list(photographs)), strict=True))
        maps, cameras = _geometry(depth, scene, photographs)
        for style, reference in styles.items():
            images = {name: found[of] for name in photographs if (of := Meaning(scene, style, name)) in found}
            if absent := tuple(name for name in photographs if name not in images):
                gaps.append(Gap(scene, style, absent, len(photographs)))
            depths = tuple(maps.get(name) for name in images)
            cell = StylizedImages(
                scene=scene,
                style=style,
                frames=tuple(images),
                content=tuple(photographs[name] for name in images),
                stylized=tuple(images.values()),
                reference=reference,
                depth=depths if any(depths) else (),
                cameras=cameras,
                numbers=tuple(numbers[name] for name in images),
            )
            cells += [cell] if images else []
    return Pairing(tuple(cells), tuple(gaps))


def _geometry(depth: Path | None, scene: str, names: Iterable[str]) -> tuple[Files, Path | None]:
    """The depth maps of a scene's photographs by their names, and the file of its cameras, as far as there are any."""
    if depth is None:
        return {}, None
    folders = {path.name: path for path in folders_in(depth)}
    folder = next((folders[name] for name in Names(folders).find(scene)), depth)
    files = _files(folder, "depth", suffixes={".npy"})
    known = Names(files)
    found = {name: known.find(name) for name in names}
    cameras = next((file for file in (folder / CAMERAS, depth / CAMERAS) if file.is_file()), None)
    return {name: files[maps[0]] for name, maps in found.items() if len(maps) == 1}, cameras


def _photographs(content: Path) -> dict[str, Files]:
    """Photographs by scene and name; the scene is empty for those in no folder."""
    photographs = {"": _files(content, "content")}
    for folder in folders_in(content):
        inside = folder / "images"
        photographs[folder.name] = _files(inside if inside.is_dir() else folder, "content")
    return {scene: files for scene, files in photographs.items() if files}


def _scenes(photographs: Mapping[str, Files], layout: str) -> dict[str, Files]:
    """The photographs by scene that results of a layout are of: those in folders, or without ``{scene}`` in none."""
    inside = {scene: files for scene, files in photographs.items() if scene}
    return inside if "{scene}" in layout or "" not in photographs else {"": photographs[""]}


def _files(folder: Path, what: str, pattern: str = "*", suffixes: Collection[str] = SUFFIXES) -> Files:
    """The files of a folder by their paths without suffix."""
    if not folder.is_dir():
        raise UserError(f"there is no {what} folder {folder}")
    files: Files = {}
    for path in sorted(folder.glob(pattern), key=lambda path: natural(path.relative_to(folder).as_posix())):
        name = unicodedata.normalize("NFC", path.relative_to(folder).with_suffix("").as_posix())
        hidden = any(part.startswith(".") for part in name.split("/"))
        if path.suffix.lower() not in suffixes or hidden or not path.is_file():
            continue
        if files.setdefault(name, path) != path:
            raise UserError(f"{files[name]} and {path} are the same image of the {what} folder; keep one of them")
    return files
