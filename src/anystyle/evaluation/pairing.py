"""Frame pairing: which photograph and which style each stylized image of three folders belongs to."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, product
from pathlib import Path
from typing import Literal, NamedTuple

from anystyle.data.images import SUFFIXES, listing
from anystyle.errors import UserError
from anystyle.evaluation.names import Names, sequence, splits
from anystyle.paths import natural

CAMERAS = "cameras.npz"

LAYOUTS = ("SCENE/STYLE/FRAME", "SCENE/STYLE_FRAME", "STYLE/FRAME", "STYLE_FRAME")
"""Of stylized images; the last two are of one scene."""

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
    """Every scene in every style that has images, and what is missing of those that photographs and styles imply.

    ``notes`` say what was left aside.
    """

    cells: tuple[StylizedImages, ...]
    missing: tuple[Gap, ...] = ()
    notes: tuple[str, ...] = ()

    def chosen(self, scenes: Collection[str], styles: Collection[str]) -> "Pairing":
        """What concerns some of the scenes and styles."""
        keys = set(product(scenes, styles))
        cells = tuple(cell for cell in self.cells if (cell.scene, cell.style) in keys)
        return Pairing(cells, tuple(gap for gap in self.missing if (gap.scene, gap.style) in keys), self.notes)

    def lacking(self) -> str:
        """What is missing, and of how many, in one line; empty if nothing is."""
        return "; ".join(filter(None, (self._images() if self.missing else "", *self._geometry())))

    def require(self) -> None:
        """Raise a UserError that names what is missing."""
        if told := self.lacking():
            raise UserError(f"{told}; add them, or missing=allow to judge what is there")

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
    content: Path, style: Path, stylized: Path, depth: Path | None = None, *, missing: MissingImages = "refuse"
) -> Pairing:
    """Find the photograph and the style of each stylized image.

    Stylized images are ``SCENE/STYLE/FRAME.png`` or ``SCENE/STYLE_FRAME.png``, of one scene also ``STYLE/FRAME.png`` or
    ``STYLE_FRAME.png``. Photographs are ``SCENE/FRAME.png`` (or ``FRAME.png``), styles ``STYLE.png``; either may also
    have the stylized image's own name, as published evaluations write them. Names are found whole, as
    :class:`~anystyle.evaluation.names.Names` does: frame ``3`` is frame ``003``. Depth, along z, is
    ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` beside it where cameras are known.

    Args:
        content: A folder, as are the next ones.
        style: Style images.
        stylized: Results.
        depth: Maps, where depth is known.
        missing: ``refuse`` raises where photographs, styles and depth imply more images than there are; ``allow`` pairs
            those that are there.

    Raises:
        UserError: A folder is missing, or an image has no partner, or may have several.
    """
    results = _files(stylized, "stylized", SUFFIXES)
    matcher = _Matcher(content, style, depth, {parts[0] for parts in results if len(parts) > 1})
    found: dict[tuple[str, str], dict[Path, _Reading]] = {}
    unmatched: list[str] = []
    for parts, path in results.items():
        readings = matcher.readings(parts, path)
        if len(readings) > 1:
            raise UserError(_ambiguous(parts, readings))
        if not readings or (depth is not None and missing == "refuse" and readings[0].depth is None):
            unmatched.append(f"{'/'.join(parts)} ({matcher.reason(parts, readings)})")
            continue
        (reading,) = readings
        cell = found.setdefault((reading.scene, reading.style), {})
        if other := cell.get(reading.photograph):
            raise UserError(f"{other.stylized} and {path} are the same image of the stylized folder; keep one of them")
        cell[reading.photograph] = reading
    if unmatched:
        told = f"{len(unmatched)} of {len(results)} stylized images have no partner: {listing(unmatched, 8)}"
        raise UserError(told + (matcher.advice(list(results), stylized) if 2 * len(unmatched) > len(results) else ""))
    pairing = matcher.pairing(found)
    if missing == "refuse":
        pairing.require()
    return pairing


class _Reading(NamedTuple):
    """What a stylized image may be."""

    scene: str
    style: str
    frame: str
    stylized: Path
    photograph: Path
    reference: Path
    depth: Path | None
    own: tuple[bool, bool]
    """Whether photograph and style image have the stylized image's own name."""


class _Files:
    """Files by scene, and in it by stem; the scene is empty for those in no folder."""

    def __init__(self, files: Mapping[tuple[str, ...], Path]) -> None:
        self.scenes: dict[str, dict[str, Path]] = {}
        for (*folders, stem), path in files.items():
            self.scenes.setdefault(folders[0] if folders else "", {})[stem] = path
        self.names = {scene: Names(stems) for scene, stems in self.scenes.items()}
        self.folders = Names(filter(None, self.scenes))

    def find(self, scene: str, *names: str) -> list[Path]:
        """The files that the first known name means, in the scene's own folder or else in none."""
        folders = [*self.folders.find(scene), *([""] if "" in self.scenes else [])]
        found = (
            [self.scenes[folder][stem] for stem in self.names[folder].find(name)]
            for name in names
            for folder in folders
        )
        return next(filter(None, found), [])

    def knows(self, name: str) -> bool:
        """Whether a name means a file of any scene."""
        return any(names.find(name) for names in self.names.values())


class _Matcher:
    """Finds the partners of stylized images among photographs, styles and depth maps."""

    def __init__(self, content: Path, style: Path, depth: Path | None, folders: Collection[str]) -> None:
        photographs = _files(content, "content", SUFFIXES)
        inside = {parts: path for parts, path in photographs.items() if len(parts) > 1}
        beside = {parts: path for parts, path in photographs.items() if len(parts) == 1}
        self.notes: tuple[str, ...] = ()
        if inside and beside:
            # Scenes in folders if stylized images' folders have their names, or else one scene beside folders.
            named = any(map(Names(parts[0] for parts in inside).find, folders))
            photographs, aside = (inside, beside) if named else (beside, inside)
            names = listing(["/".join(parts) for parts in aside], 8)
            self.notes = (f"{len(aside)} photographs are left aside: {names}",)
        self.content = _Files(photographs)
        self.style = _Files(_files(style, "style", SUFFIXES))
        self.depth = _Files({} if depth is None else _files(depth, "depth", frozenset({".npy"})))
        self.roots = content, depth
        self.scene = next(iter(self.content.scenes)) if len(self.content.scenes) == 1 else ""
        """The only one."""

    def readings(self, parts: tuple[str, ...], path: Path) -> list[_Reading]:
        """What an image may be, one reading for each pair of a photograph and a style image."""
        found: dict[tuple[Path, Path], _Reading] = {}
        for scene, style, frame, own in self._candidates(parts):
            owned = bool(self.content.find(scene, own)), bool(self.style.find(scene, own))
            maps = self.depth.find(scene, frame, own)
            depth, known = maps[0] if len(maps) == 1 else None, next(iter(self.content.folders.find(scene)), scene)
            for pair in product(self.content.find(scene, own, frame), self.style.find(scene, own, style)):
                found[pair] = _Reading(known, style if owned[1] else pair[1].stem, frame, path, *pair, depth, owned)
        return list(found.values())

    def _candidates(self, parts: tuple[str, ...]) -> Iterator[tuple[str, str, str, str]]:
        """Scene, style, frame and own name that a path may stand for; of equal partners the last is right."""
        *folders, stem = parts
        if len(folders) == 2:
            yield folders[0], folders[1], stem, f"{folders[1]}_{stem}"
        elif len(folders) < 2:
            scene = folders[0] if folders else self.scene
            yield scene, stem, stem, stem
            if folders and len(self.content.scenes) == 1:
                yield self.scene, folders[0], stem, f"{folders[0]}_{stem}"
            for style, frame in splits(stem):
                yield scene, style, frame, stem

    def reason(self, parts: tuple[str, ...], readings: Sequence[_Reading]) -> str:
        """Why an image cannot be judged, by the reading that fits best."""
        if readings:
            return f"no depth {readings[0].frame}"
        best: list[str] | None = None
        for scene, style, frame, own in self._candidates(parts):
            lacks = [f"no content {frame}"] * (not self.content.find(scene, own, frame))
            lacks += [f"no style {style}"] * (not self.style.find(scene, own, style))
            best = lacks if best is None or len(lacks) <= len(best) else best
        return ", ".join(best or ["too many folders"])

    def pairing(self, found: Mapping[tuple[str, str], Mapping[Path, _Reading]]) -> Pairing:
        """Cells in order, and the gaps between them."""
        scenes = [scene for scene in self.content.scenes if scene] or list(dict.fromkeys(scene for scene, _ in found))
        if "" in self.content.scenes and len(scenes) > 1:
            raise UserError(
                f"the photographs in {self.roots[0]} are of one scene, and the stylized images of {len(scenes)} "
                f"({listing(scenes, 4)}); give --content the folder of SCENE/FRAME.png"
            )
        own = [any(reading.own[index] for cell in found.values() for reading in cell.values()) for index in (0, 1)]
        cells: list[StylizedImages] = []
        gaps: list[Gap] = []
        for scene in sorted(scenes, key=natural):
            numbers, expected = self._expected(scene, own)
            for style in sorted({*expected, *(name for one, name in found if one == scene)}, key=natural):
                frames, rows = expected.get(style, {}), found.get((scene, style), {})
                if absent := tuple(frame for path, frame in frames.items() if path not in rows):
                    gaps.append(Gap(scene, style, absent, len(frames)))
                if rows:
                    cells.append(self._cell(sorted(rows.values(), key=lambda row: numbers[row.photograph]), numbers))
        return Pairing(tuple(cells), tuple(gaps), self.notes)

    def _expected(self, scene: str, own: Sequence[bool]) -> tuple[dict[Path, int], dict[str, dict[Path, str]]]:
        """The number of each photograph in its sequence, and the frames of each style, by photograph."""
        photographs = self.content.scenes.get(scene) or self.content.scenes[""]
        folders = ["", *self.style.folders.find(scene)]
        styles = [stem for folder in folders for stem in self.style.scenes.get(folder, {})]
        expected: dict[str, dict[Path, str]] = {}
        if not own[0]:
            numbers = dict(zip(photographs.values(), sequence(list(photographs)), strict=True))
            for style in styles:
                label = (style.rpartition("_")[0] or style) if own[1] else style
                expected[label] = {path: stem for stem, path in photographs.items()}
            return numbers, expected
        labels: dict[Path, tuple[str, str]] = {}
        for stem, path in photographs.items():
            labels[path] = (splits(stem) or [(stem, stem)])[-1]
            for style, frame in splits(stem) if not own[1] else ():
                for reference in self.style.find(scene, style):
                    labels[path] = reference.stem, frame
            expected.setdefault(labels[path][0], {})[path] = labels[path][1]
        frames = sorted({frame for _, frame in labels.values()}, key=natural)
        places = dict(zip(frames, sequence(frames), strict=True))
        return {path: places[frame] for path, (_, frame) in labels.items()}, expected

    def _cell(self, rows: Sequence[_Reading], numbers: Mapping[Path, int]) -> StylizedImages:
        scene, root = rows[0].scene, self.roots[1]
        cameras = None
        if root is not None:
            files = (root / folder / CAMERAS for folder in (scene, *self.depth.folders.find(scene), ""))
            cameras = next((file for file in files if file.is_file()), None)
        depth = tuple(row.depth for row in rows)
        return StylizedImages(
            scene=scene,
            style=rows[0].style,
            frames=tuple(row.frame for row in rows),
            content=tuple(row.photograph for row in rows),
            stylized=tuple(row.stylized for row in rows),
            reference=rows[0].reference,
            depth=depth if any(depth) else (),
            cameras=cameras,
            numbers=tuple(numbers[row.photograph] for row in rows),
        )

    def advice(self, results: Sequence[tuple[str, ...]], stylized: Path) -> str:
        """The layout that most images seem to have, and what to do about it."""
        if "" not in self.style.scenes and not any(map(self.content.folders.find, self.style.scenes)):
            folders = listing(list(self.style.scenes), 3)
            return f"; the style images lie in folders ({folders}): give --style one of them"
        looked = results[:200]
        ((layout, count),) = Counter(filter(None, map(self._layout, looked))).most_common(1) or [("", 0)]
        if 2 * count <= len(looked):
            names = (repr(next(iter(next(iter(files.scenes.values()))))) for files in (self.content, self.style))
            return f"; expected {LAYOUTS[0]}.png, with frames named like {' and styles like '.join(names)}"
        told = f"; these look like {layout}.png"
        if layout in LAYOUTS:
            scenes = listing([name for name in self.content.scenes if name], 4)
            return f"{told} of one scene, and --content holds several ({scenes}): give it the folder of that scene"
        if layout.startswith("FOLDER/") and layout.removeprefix("FOLDER/") in LAYOUTS:
            return f"{told}: give --stylized one folder, such as {stylized / results[0][0]}"
        return f"{told}: arrange them as {'SCENE/' if self.content.folders else ''}STYLE/FRAME.png"

    def _layout(self, parts: tuple[str, ...]) -> str | None:
        """The layout of known names that a path has; what is not known is a FOLDER."""
        *folders, stem = map(self._kinds, parts)
        layouts = map("/".join, product(*([*kinds, "FOLDER"] for kinds in folders), stem))
        fits = (one for one in layouts if one.count("STYLE") == one.count("FRAME") == 1 >= one.count("SCENE"))
        return min(fits, key=lambda layout: layout.count("FOLDER"), default=None)

    def _kinds(self, name: str) -> list[str]:
        """What a name may be: a scene, a style, a frame, or several of them."""
        known = bool(self.content.folders.find(name)), self.style.knows(name), self.content.knows(name)
        kinds = list(compress(("SCENE", "STYLE", "FRAME"), known))
        for left, right in splits(name, "_-. "):
            kinds += [f"{one}{name[len(left)]}{other}" for one in self._kinds(left) for other in self._kinds(right)]
        return kinds


def _ambiguous(parts: tuple[str, ...], readings: Sequence[_Reading]) -> str:
    said = [f"{one.photograph.name} in style {one.reference.name}" for one in readings]
    typed = [f"{one.scene}/{one.style}/{one.photograph.stem}".lstrip("/") for one in readings]
    return f"{'/'.join(parts)} may be {' or '.join(said)}; name it {' or '.join(typed)}"


def _files(folder: Path, what: str, suffixes: frozenset[str]) -> dict[tuple[str, ...], Path]:
    """Files by their folders and stem, in natural order; folders named ``images`` are left out of account."""
    if not folder.is_dir():
        raise UserError(f"there is no {what} folder {folder}")
    patterns = ["*", "*/*", "*/images/*"] + ["*/*/*", "*/images/*/*"] * (what == "stylized")
    if found := _globbed(folder, what, patterns, suffixes):
        return found
    inside = _globbed(folder, what, ["*/" * depth + "*" for depth in range(2, 6)], suffixes)
    if not inside:
        raise UserError(f"the {what} folder {folder} holds no {'depth (.npy)' if what == 'depth' else 'image'}")
    if expected := {"content": "SCENE/FRAME.png", "style": "STYLE.png", "depth": "SCENE/FRAME.npy"}.get(what):
        example = next(iter(inside.values())).relative_to(folder).as_posix()
        raise UserError(f"the {what} folder {folder} holds {example}, and {expected} is expected; give its folder")
    return inside


def _globbed(folder: Path, what: str, patterns: Iterable[str], suffixes: frozenset[str]) -> dict[tuple[str, ...], Path]:
    paths = {path for pattern in patterns for path in folder.glob(pattern)}
    files: dict[tuple[str, ...], Path] = {}
    for path in sorted(paths, key=lambda path: natural(path.relative_to(folder).as_posix())):
        parts = path.relative_to(folder).parts
        hidden = any(part.startswith(".") for part in parts)
        beside = len(parts) > 1 and parts[1] != "images" and (folder / parts[0] / "images").is_dir()
        if path.suffix.lower() not in suffixes or hidden or beside or not path.is_file():
            continue
        key = (*(part for part in parts[:-1] if part != "images"), path.stem)
        if key in files:
            raise UserError(f"{files[key]} and {path} are the same image of the {what} folder; keep one of them")
        files[key] = path
    return files
