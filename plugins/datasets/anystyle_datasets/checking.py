"""What a folder of training data holds, and what in it is missing or damaged."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from PIL import Image

from anystyle.data.captions import read_captions
from anystyle.data.folder import image_files
from anystyle.data.images import SUFFIXES, image_size, listing, open_image
from anystyle.data.poses import frame_names, read_poses
from anystyle.data.scene_folder import FolderScenes
from anystyle.errors import UserError
from anystyle.io.documents import read_json, read_text
from anystyle.io.images import Picture
from anystyle_datasets.re10k import Re10kScenes
from anystyle_datasets.wikiart import DESCRIPTIONS, TEST_FILES

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
    """What a folder holds, and the words (``use``) that train on it."""

    layout: Layout
    use: str
    scenes: int = 0  # that can be used; 0 for styles
    images: int = 0  # that can be decoded
    sizes: Counter[tuple[int, int]] = field(default_factory=Counter)  # images of each width and height
    views: Counter[int] = field(default_factory=Counter)  # scenes with each number of views
    posed: int = 0  # images with a camera
    texts: int = 0  # images with a description
    problems: list[str] = field(default_factory=list)


def check(root: Path, *, layout: Layout | None = None, min_views: int = 2, decode: bool = True) -> Report:
    """Look at every file of a folder of scenes or styles.

    The layout is recognised if none is given; scenes with fewer views than ``min_views`` are reported. Without
    ``decode`` headers alone are read, and files that end too early are not found.
    """
    if not root.is_dir():
        raise UserError(f"there is no folder {root}")
    chosen = layout or guess(root)
    readers = {"scenes": _scenes, "re10k": _re10k, "styles": _styles, "wikiart": _wikiart}
    return readers[chosen](root, min_views, decode)


def guess(root: Path) -> Layout:
    """How a folder is laid out, by what lies in it."""
    if any((root / split / "index.json").is_file() for split in ("train", "test")):
        return "re10k"
    if any((root / name).is_file() for name in (DESCRIPTIONS, TEST_FILES)):
        return "wikiart"
    return "styles" if (root / "captions.jsonl").is_file() else "scenes"


def _scenes(root: Path, min_views: int, decode: bool) -> Report:
    index = "train_index.json" if (root / "train_index.json").is_file() else None
    names: list[str] = [] if index is None else read_json(root / index, list[str], what="JSON list of folder names")
    inside = [root, *(path for path in root.iterdir() if path.is_dir()), *(root / name for name in names)]
    images = next((name for name in IMAGE_FOLDERS if any((path / name).is_dir() for path in inside)), "images")
    cameras = IMAGE_FOLDERS[images]
    words = [f"scenes=folder scenes.root={root}"]
    words += [] if images == "images" else [f"scenes.images={images}"]
    words += [] if index is None else [f"scenes.index={index}"]
    if cameras is not None:
        words = [f"scenes=scannetpp scenes.root={root}"]
    elif images != "images" and index is not None:
        words = [f"scenes=dl3dv scenes.root={root}"] + ([] if images == "images_8" else [f"scenes.images={images}"])
    report = Report("scenes", " ".join(words))
    report.problems += [f"{name}: in {index}, and not there" for name in names if not (root / name).is_dir()]
    for folder in FolderScenes(root=str(root), index=index, images=images, cameras=cameras).folders:
        _scene(folder, images, cameras, report, min_views, decode)
    return report


def _scene(folder: Path, images: str, cameras: str | None, report: Report, min_views: int, decode: bool) -> None:
    inside = folder / images if (folder / images).is_dir() else folder
    paths = image_files(inside)
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
    report.posed += len(known) if stored else 0
    _count(report, str(folder), len(known), min_views)


def _count(report: Report, scene: str, views: int, min_views: int) -> None:
    report.views[views] += 1
    report.scenes += views >= min_views
    if views < min_views:
        report.problems.append(f"{scene}: {views} views, fewer than {min_views}")


def _re10k(root: Path, min_views: int, decode: bool) -> Report:
    report = Report("re10k", f"scenes=re10k scenes.root={root}")
    for split in ("train", "test"):
        if not (root / split / "index.json").is_file():
            continue
        source = Re10kScenes(root=str(root), split=split)
        for scene in range(len(source)):
            name = f"{split}/{source.name(scene)}"
            try:
                frames = source.frames(scene)
            except ValueError as error:
                report.problems.append(f"{name}: {error}")
                continue
            good = len(_look(frames, report, decode, [f"{name}: frame {number}" for number in range(len(frames))]))
            report.posed += good
            _count(report, name, good, min_views)
    return report


def _styles(root: Path, min_views: int, decode: bool) -> Report:
    report = Report("styles", f"styles=folder styles.root={root}")
    _described(image_files(root), root, root / "captions.jsonl", report, decode)
    return report


def _wikiart(root: Path, min_views: int, decode: bool) -> Report:
    paths = sorted(path for path in root.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    report = Report("wikiart", f"styles=wikiart styles.root={root}")
    if not (root / DESCRIPTIONS).is_file():
        report.problems.append(f"{root / DESCRIPTIONS} is not there: paintings are described by their folders")
    present = _described(paths, root, root / DESCRIPTIONS, report, decode)
    tests = root / TEST_FILES
    if tests.is_file():
        lines = [line.strip() for line in read_text(tests).splitlines() if line.strip()]
        report.problems += [f"{tests.name} names {line}, which is not there" for line in lines if line not in present]
    else:
        report.problems.append(f"{tests} is not there: no painting is kept for tests")
    return report


def _described(paths: Sequence[Path], root: Path, captions: Path, report: Report, decode: bool) -> set[str]:
    """Check images against a file of captions; the result is the images' paths below the root."""
    texts = read_captions(captions) if captions.is_file() else {}
    report.texts = sum(bool(texts.get(path.relative_to(root).as_posix())) for path in _look(paths, report, decode))
    present = {path.relative_to(root).as_posix() for path in paths}
    report.problems += [f"{name} has a description and is not there" for name in texts if name not in present]
    return present


def _look(sources: Sequence[P], report: Report, decode: bool, titles: Sequence[str] | None = None) -> list[P]:
    """Those images that can be read; the others are problems. Titles name encoded bytes in messages."""
    good = []
    with ThreadPoolExecutor(4) as pool:
        results = pool.map(partial(_size, decode=decode), sources, titles or [""] * len(sources))
        for source, result in zip(sources, results, strict=True):
            if isinstance(result, str):
                report.problems.append(result)
            else:
                report.images += 1
                report.sizes[result] += 1
                good.append(source)
    return good


def _size(source: Picture, title: str, decode: bool) -> tuple[int, int] | str:
    """Width and height of an image, or why it cannot be read."""
    try:
        if decode:
            open_image(source, title, longest=64)
        return image_size(source, title)
    except (UserError, OSError) as error:
        return str(error)


SAME = 10
"""Bits of 256 that two copies of one picture may differ in; unrelated ones differ in about 128."""


def fingerprint(path: Path) -> int:
    """256 bits: whether each of 16 x 16 parts of a picture is darker than its neighbour to the right."""
    small = open_image(path, longest=256).convert("L").resize((17, 16), Image.Resampling.LANCZOS)
    grey = np.asarray(small, dtype=np.int16)
    return int.from_bytes(np.packbits(grey[:, 1:] > grey[:, :-1]).tobytes(), "big")


def same_pictures(paths: Iterable[Path], others: Iterable[Path]) -> Mapping[Path, Path]:
    """For each file that shows the same as one of ``others``, the first such one; unreadable files match nothing."""
    known = _fingerprints(others)
    matches: dict[Path, Path] = {}
    for path, bits in _fingerprints(paths):
        match = next((other for other, other_bits in known if (bits ^ other_bits).bit_count() <= SAME), None)
        if match is not None:
            matches[path] = match
    return matches


def _fingerprints(paths: Iterable[Path]) -> list[tuple[Path, int]]:
    def found(path: Path) -> list[tuple[Path, int]]:
        try:
            return [(path, fingerprint(path))]
        except (UserError, OSError):
            return []

    with ThreadPoolExecutor(4) as pool:
        return [pair for pairs in pool.map(found, paths) for pair in pairs]
