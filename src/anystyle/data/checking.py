"""What a folder of training data holds, and what in it is missing or broken."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from PIL import Image

from anystyle.data.captioning import read_captions
from anystyle.data.images import SUFFIXES, image_size, listing, open_image
from anystyle.data.poses import frame_names, read_poses
from anystyle.data.re10k import Re10kScenes
from anystyle.data.scene_folder import FolderScenes
from anystyle.data.wikiart import DESCRIPTIONS, TEST_FILES
from anystyle.documents import read_json, read_text
from anystyle.io.images import Picture

P = TypeVar("P", Path, bytes)
Layout = Literal["scenes", "re10k", "styles", "wikiart"]
IMAGE_FOLDERS: dict[str, str | None] = {
    "images": None,
    "images_8": None,
    "images_4": None,
    "dslr/resized_undistorted_images": "dslr/nerfstudio/transforms_undistorted.json",
}
"""Where photographs lie in a scene's folder, and where its cameras do, if not beside them; the last is ScanNet++'s."""


@dataclass
class Report:
    """What a folder holds.

    Args:
        layout: How the folder was read.
        use: The words that train on it.
        scenes: How many scenes can be used; 0 for styles.
        images: How many images can be decoded.
        sizes: How many images have each width and height.
        views: How many scenes have each number of views.
        posed: How many images have a camera.
        texts: How many images have a description.
        problems: A line for each thing that is missing or broken.
    """

    layout: Layout
    use: str
    scenes: int = 0
    images: int = 0
    sizes: Counter[tuple[int, int]] = field(default_factory=Counter)
    views: Counter[int] = field(default_factory=Counter)
    posed: int = 0
    texts: int = 0
    problems: list[str] = field(default_factory=list)


def check(root: Path, *, layout: Layout | None = None, min_views: int = 2, decode: bool = True) -> Report:
    """Look at every file of a folder of scenes or styles.

    Args:
        root: The folder.
        layout: How to read it; ``None`` finds out.
        min_views: A scene with fewer is reported.
        decode: Whether pixels are decoded, which finds files that end too early; else headers alone.

    Raises:
        ValueError: There is nothing to be found there.
    """
    if not root.is_dir():
        raise ValueError(f"there is no folder {root}")
    chosen = layout or guess(root)
    readers = {"scenes": _scenes, "re10k": _re10k, "styles": _styles, "wikiart": _wikiart}
    return readers[chosen](root, min_views, decode)


def guess(root: Path) -> Layout:
    """How a folder is laid out, by what lies in it."""
    if any((root / split / "index.json").is_file() for split in ("train", "test")):
        return "re10k"
    if any((root / name).is_file() for name in (DESCRIPTIONS, TEST_FILES)):
        return "wikiart"
    if (root / "captions.jsonl").is_file():
        return "styles"
    return "scenes"


def _scenes(root: Path, min_views: int, decode: bool) -> Report:
    index = "train_index.json" if (root / "train_index.json").is_file() else None
    present = (
        name for name in IMAGE_FOLDERS if (root / name).is_dir() or next(root.glob(f"*/{name}/"), None) is not None
    )
    images = next(present, None if index is None else _indexed(root, root / index)) or "images"
    cameras = IMAGE_FOLDERS[images]
    probe = FolderScenes(root=str(root), index=index, images=images, cameras=cameras)
    report = Report("scenes", _words(root, images, cameras, index))
    if index is not None:
        names: list[str] = read_json(root / index, list[str], what="JSON list of folder names")
        report.problems += [f"{name}: in {index}, and not there" for name in names if not (root / name).is_dir()]
    for folder in probe.folders:
        _scene(folder, images, cameras, report, min_views, decode)
    return report


def _words(root: Path, images: str, cameras: str | None, index: str | None) -> str:
    if cameras is not None:
        return f"scenes=scannetpp scenes.root={root}"
    if images != "images" and index is not None:
        return f"scenes=dl3dv scenes.root={root}" + ("" if images == "images_8" else f" scenes.images={images}")
    words = [f"scenes=folder scenes.root={root}"]
    words += [] if images == "images" else [f"scenes.images={images}"]
    words += [] if index is None else [f"scenes.index={index}"]
    return " ".join(words)


def _indexed(root: Path, index: Path) -> str | None:
    """Where the photographs of the first scene of an index lie that is there."""
    folders = FolderScenes(root=str(root), index=index.name).folders
    first = next((folder for folder in folders if folder.is_dir()), root)
    return next((name for name in IMAGE_FOLDERS if (first / name).is_dir()), None)


def _scene(folder: Path, images: str, cameras: str | None, report: Report, min_views: int, decode: bool) -> None:
    inside = folder / images if (folder / images).is_dir() else folder
    paths = sorted(path for path in inside.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    good = _look(paths, report, decode)
    try:
        stored = read_poses(folder, [path.name for path in paths], cameras) if paths else {}
    except ValueError as error:
        report.problems.append(str(error))
        return
    known = [path for path in good if not stored or path.name in stored]
    if len(known) < len(good):
        report.problems.append(f"{folder}: {len(good) - len(known)} photographs have no camera")
    file = folder / (cameras or "transforms.json")
    listed = frame_names(file) if file.is_file() else []
    names = {path.name for path in paths} | {path.stem for path in paths}
    absent = [name for name in listed if name not in names]
    if absent:
        report.problems.append(
            f"{folder}: {file.name} names {listing(absent, 5)}: {len(absent)} of {len(listed)} are not in {inside.name}"
        )
    report.views[len(known)] += 1
    report.posed += len(known) if stored else 0
    report.scenes += len(known) >= min_views
    if len(known) < min_views:
        report.problems.append(f"{folder}: {len(known)} views, fewer than {min_views}")


def _re10k(root: Path, min_views: int, decode: bool) -> Report:
    report = Report("re10k", f"scenes=re10k scenes.root={root}")
    for split in ("train", "test"):
        if not (root / split / "index.json").is_file():
            continue
        source = Re10kScenes(root=str(root), split=split)
        for scene in range(len(source)):
            try:
                frames = source.frames(scene)
            except ValueError as error:
                report.problems.append(f"{split}/{source.name(scene)}: {error}")
                continue
            name = f"{split}/{source.name(scene)}"
            titles = [f"{name}: frame {number}" for number in range(len(frames))]
            good = len(_look(frames, report, decode, titles))
            report.views[good] += 1
            report.scenes += good >= min_views
            report.posed += good
            if good < min_views:
                report.problems.append(f"{name}: {good} views, fewer than {min_views}")
    return report


def _styles(root: Path, min_views: int, decode: bool) -> Report:
    paths = sorted(path for path in root.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    captions = root / "captions.jsonl"
    report = Report("styles", f"styles=folder styles.root={root}")
    _described(paths, root, read_captions(captions) if captions.is_file() else {}, report, decode)
    return report


def _wikiart(root: Path, min_views: int, decode: bool) -> Report:
    paths = sorted(path for path in root.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    file = root / DESCRIPTIONS
    report = Report("wikiart", f"styles=wikiart styles.root={root}")
    if not file.is_file():
        report.problems.append(f"{file} is not there: paintings are described by their folders")
    _described(paths, root, read_captions(file) if file.is_file() else {}, report, decode)
    tests = root / TEST_FILES
    if tests.is_file():
        present = {path.relative_to(root).as_posix() for path in paths}
        lines = [line.strip() for line in read_text(tests).splitlines() if line.strip()]
        report.problems += [f"{tests.name} names {line}, which is not there" for line in lines if line not in present]
    else:
        report.problems.append(f"{tests} is not there: no painting is kept for tests")
    return report


def _described(paths: Sequence[Path], root: Path, texts: dict[str, str], report: Report, decode: bool) -> None:
    good = _look(paths, report, decode)
    report.texts = sum(bool(texts.get(path.relative_to(root).as_posix())) for path in good)
    present = {path.relative_to(root).as_posix() for path in paths}
    report.problems += [f"{name} has a description and is not there" for name in texts if name not in present]


def _look(sources: Sequence[P], report: Report, decode: bool, titles: Sequence[str] | None = None) -> list[P]:
    """Those images that can be read; the others are problems. Titles are what messages call bytes."""
    good = []
    with ThreadPoolExecutor(4) as pool:
        results = pool.map(_open if decode else _measure, sources, titles or [""] * len(sources))
        for source, result in zip(sources, results, strict=True):
            if isinstance(result, str):
                report.problems.append(result)
            else:
                report.images += 1
                report.sizes[result] += 1
                good.append(source)
    return good


def _measure(source: Picture, title: str) -> tuple[int, int] | str:
    try:
        return image_size(source, title)
    except (ValueError, OSError) as error:
        return str(error)


def _open(source: Picture, title: str) -> tuple[int, int] | str:
    try:
        open_image(source, title, longest=64)
    except (ValueError, OSError) as error:
        return str(error)
    return _measure(source, title)


SAME = 10
"""Bits of 256 that two copies of one picture may differ in; unrelated ones differ in about 128."""


def fingerprint(path: Path) -> int:
    """256 bits: whether each of 16 x 16 parts of a picture is darker than its neighbour to the right.

    Raises:
        ValueError: It is no image, or a damaged one.
    """
    small = open_image(path, longest=256).convert("L").resize((17, 16), Image.Resampling.LANCZOS)
    grey = np.asarray(small, dtype=np.int16)
    return int.from_bytes(np.packbits(grey[:, 1:] > grey[:, :-1]).tobytes(), "big")


def same_pictures(paths: Iterable[Path], others: Iterable[Path]) -> Mapping[Path, Path]:
    """For each file that shows what one of ``others`` shows, the first such one; unreadable files match nothing."""
    known = [(print_, path) for path, print_ in _fingerprints(others)]
    matches: dict[Path, Path] = {}
    for path, print_ in _fingerprints(paths):
        match = next((other for known_print, other in known if (print_ ^ known_print).bit_count() <= SAME), None)
        if match is not None:
            matches[path] = match
    return matches


def _fingerprints(paths: Iterable[Path]) -> list[tuple[Path, int]]:
    every = list(paths)
    with ThreadPoolExecutor(4) as pool:
        prints = list(pool.map(_try, every))
    return [(path, print_) for path, print_ in zip(every, prints, strict=True) if print_ is not None]


def _try(path: Path) -> int | None:
    try:
        return fingerprint(path)
    except (ValueError, OSError):
        return None
