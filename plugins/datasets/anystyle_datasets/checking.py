"""What a folder of training data holds, and what in it is missing or damaged."""

import os
import re
import shlex
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

from anystyle.data.captions import captions_file, read_captions
from anystyle.data.folder import image_files
from anystyle.data.images import image_size, open_image
from anystyle.data.names import matched
from anystyle.data.poses import read_poses, stored_cameras
from anystyle.data.scene_folder import FolderScenes
from anystyle.errors import UserError, listing
from anystyle.io.documents import kept_json, read_json
from anystyle.io.images import Picture
from anystyle.registry.compose import override
from anystyle_datasets.re10k import Re10kScenes
from anystyle_datasets.wikiart import DESCRIPTIONS, MOVEMENTS, TEST_FILES, pictures_below, read_list

P = TypeVar("P", Path, bytes)
FolderKind = Literal["scenes", "re10k", "styles", "wikiart"]
INDEX = "train_index.json"
"""DL3DV's list of scenes."""
REDUCED = ("images_8", "images_4")
"""Where DL3DV keeps photographs: those of 480P, of 960P."""
IMAGE_FOLDERS: dict[str, str | None] = {
    "images": None,
    "images_8": None,
    "images_4": None,
    "dslr/resized_undistorted_images": "dslr/nerfstudio/transforms_undistorted.json",
}
"""Where photographs lie in a scene's folder, and where its cameras do, if not beside them; the last is ScanNet++'s."""


@dataclass
class FolderReport:
    """What a folder holds, and the overrides (``use``) that train on it."""

    layout: FolderKind
    use: str
    usable: list[str] = field(default_factory=list)  # names of the scenes with enough views; none for styles
    unlisted: bool = False  # ``use`` names a list of scenes that is not there
    images: int = 0  # that can be decoded
    sizes: Counter[tuple[int, int]] = field(default_factory=Counter)  # images of each width and height
    views: Counter[int] = field(default_factory=Counter)  # scenes with each number of views
    posed: int = 0  # images with a camera
    texts: int = 0  # images with a description
    problems: list[str] = field(default_factory=list)


def check(root: Path, *, layout: FolderKind | None = None, min_views: int = 2, decode: bool = True) -> FolderReport:
    """Look at every file of a folder of scenes or styles.

    The layout is recognised if none is given; scenes with fewer views than ``min_views`` are reported. Without
    ``decode`` only headers are read, and files that end too early are not found.
    """
    if not root.is_dir():
        raise UserError(f"there is no folder {root}")
    root = root if layout else locate(root)
    chosen = layout or guess(root)
    readers = {"scenes": _scenes, "re10k": _re10k, "styles": _styles, "wikiart": _wikiart}
    return readers[chosen](root, min_views, decode)


def locate(root: Path) -> Path:
    """Where clips or paintings lie: in the folder, or in the only one that is in it, as archives unpack them."""
    inner, inside = root, [root]
    while guess(inner) == "scenes" and len(inside) == 1 and inside[0].is_dir():
        inner = inside[0]
        inside = [path for path in inner.iterdir() if not path.name.startswith(".")]
    return root if guess(inner) == "scenes" else inner


def guess(root: Path) -> FolderKind:
    """How a folder is laid out, by what lies in it."""
    splits = [root / split for split in ("train", "test")]
    if any((split / "index.json").is_file() or any(split.glob("*.txt")) for split in splits):
        return "re10k"
    names = {path.name for path in root.iterdir()}
    if names & {DESCRIPTIONS, TEST_FILES, *MOVEMENTS} or exported(root):
        return "wikiart"
    described = {"captions.jsonl", "style_descriptions.txt"} & names
    return "styles" if described or root.name in ("styles", "style_images") else "scenes"


def exported(root: Path) -> list[Path]:
    """Tables of paintings, as data sets are exported from the Hugging Face hub."""
    return sorted(path for folder in (root, root / "data") for path in folder.glob("*.parquet"))


def nested_scenes(root: Path) -> list[Path]:
    """The folders of DL3DV's scenes at any depth, in order: those that hold reduced photographs without originals.

    Those that ``test_index.json`` names, if there is one, are left out.
    """
    found: list[Path] = []
    for folder, inside, _ in os.walk(root):
        path = Path(folder)
        reduced = [name for name in REDUCED if name in inside and image_files(path / name)]
        if reduced and path != root and "images" not in inside:
            found.append(path)
            inside.clear()
        inside[:] = [name for name in inside if not name.startswith(".")]
    tests = kept_json(root / "test_index.json", list[str]) or []
    return sorted(path for path in found if path.relative_to(root).as_posix() not in tests)


def packed(root: Path) -> list[Path]:
    """DL3DV's archives that are not unpacked yet, one per scene and named by its hash."""
    archives = (path for pattern in ("*.zip", "*/*.zip", "*/*/*.zip") for path in root.glob(pattern))
    hashes = (path for path in archives if re.fullmatch("[0-9a-f]{64}", path.stem))
    return sorted(path for path in hashes if not path.with_suffix("").is_dir())


def words(**options: object) -> str:
    """``key=value`` for a shell, a double underscore for each dot of a key."""
    pairs = ((key.replace("__", "."), str(value)) for key, value in options.items())
    plain = re.compile(r"[\w./~+-]+")
    return shlex.join(f"{key}={text}" if plain.fullmatch(text) else override(key, text) for key, text in pairs)


def _scenes(root: Path, min_views: int, decode: bool) -> FolderReport:
    index = INDEX if (root / INDEX).is_file() else None
    names: list[str] = [] if index is None else read_json(root / index, list[str], what="JSON list of folder names")
    nested = nested_scenes(root) if index is None else []
    inside = [root, *(path for path in root.iterdir() if path.is_dir()), *(root / name for name in names), *nested]
    images = next((name for name in IMAGE_FOLDERS if any((path / name).is_dir() for path in inside)), "images")
    cameras = IMAGE_FOLDERS[images]
    source = "scannetpp" if cameras else "dl3dv" if images in REDUCED and (index or nested) else "folder"
    options: dict[str, object] = {"scenes": source, "scenes__root": root}
    if images != {"scannetpp": images, "dl3dv": "images_8", "folder": "images"}[source]:
        options["scenes__images"] = images
    if index and source == "folder":
        options["scenes__index"] = index
    report = FolderReport("scenes", words(**options), unlisted=bool(nested))
    report.problems += [f"{name}: in {index}, and not there" for name in names if not (root / name).is_dir()]
    if archives := packed(root):
        report.problems.append(f"{len(archives)} scenes are packed, such as {archives[0]}")
    if nested:
        report.problems.append(f"{root / INDEX} is not there")
    folders = nested
    if not nested and (names or not archives):
        folders = FolderScenes(root=str(root), index=index, images=images, cameras=cameras).folders
    for folder in folders:
        _scene(root, folder, images, cameras, report, min_views, decode)
    return report


def _scene(
    root: Path, folder: Path, images: str, cameras: str | None, report: FolderReport, min_views: int, decode: bool
) -> None:
    inside = folder / images if (folder / images).is_dir() else folder
    paths = image_files(inside)
    good = _look(paths, report, decode)
    try:
        stored = read_poses(folder, paths, cameras) if paths else {}
    except ValueError as error:
        report.problems.append(str(error))
        return
    known = [path for path in good if not stored or path in stored]
    if len(known) < len(good):
        report.problems.append(f"{folder}: {len(good) - len(known)} photographs have no camera")
    file = folder / (cameras or "transforms.json")
    listed = list(stored_cameras(file)) if file.is_file() else []
    present = set(matched(listed, paths).values())
    absent = [name for name in listed if name not in present]
    if absent:
        report.problems.append(
            f"{folder}: {file.name} names {listing(absent, 5)}: {len(absent)} of {len(listed)} are not in {inside.name}"
        )
    report.posed += len(known) if stored else 0
    _count(report, folder.relative_to(root).as_posix(), len(known), min_views)


def _count(report: FolderReport, scene: str, views: int, min_views: int) -> None:
    report.views[views] += 1
    if views >= min_views:
        report.usable.append(scene)
    else:
        report.problems.append(f"{scene}: {views} views, fewer than {min_views}")


def _re10k(root: Path, min_views: int, decode: bool) -> FolderReport:
    use = words(scenes="re10k", scenes__root=root, scenes__short_side=360, scenes__multiple=1)
    report = FolderReport("re10k", use)
    for split in ("train", "test"):
        lists = {path.stem for path in (root / split).glob("*.txt")}
        there = (root / split / "index.json").is_file()
        clips = read_json(root / split / "index.json", dict[str, str]).keys() if there else set[str]()
        if lists - clips:
            report.problems.append(f"{split}: {len(lists - clips)} of {len(lists)} camera lists are in no chunk")
        if not there:
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


def _styles(root: Path, min_views: int, decode: bool) -> FolderReport:
    report = FolderReport("styles", words(styles="folder", styles__root=root))
    captions = captions_file(root)
    if captions is None:
        report.problems.append(f"{root / 'captions.jsonl'} is not there: the pictures have no texts")
    _described(image_files(root), root, captions or root / "captions.jsonl", report, decode)
    return report


def _wikiart(root: Path, min_views: int, decode: bool) -> FolderReport:
    paths = pictures_below(root)
    report = FolderReport("wikiart", words(styles="wikiart", styles__root=root))
    if not (root / DESCRIPTIONS).is_file():
        report.problems.append(f"{root / DESCRIPTIONS} is not there: paintings are described by their folders")
    if exported(root) and not paths:
        report.problems.append(f"{len(exported(root))} tables of paintings are not unpacked")
    present = _described(paths, root, root / DESCRIPTIONS, report, decode)
    tests = root / TEST_FILES
    if tests.is_file():
        absent = (line for line in read_list(tests) if line not in present)
        report.problems += [f"{tests.name} names {line}, which is not there" for line in absent]
    else:
        report.problems.append(f"{tests} is not there: no painting is kept for tests")
    return report


def _described(paths: Sequence[Path], root: Path, captions: Path, report: FolderReport, decode: bool) -> set[str]:
    """Check images against a file of captions; the result is the images' paths below the root."""
    texts = read_captions(captions) if captions.is_file() else {}
    report.texts = sum(bool(texts.get(path.relative_to(root).as_posix())) for path in _look(paths, report, decode))
    present = {path.relative_to(root).as_posix() for path in paths}
    report.problems += [f"{name} has a description and is not there" for name in texts if name not in present]
    return present


def _look(sources: Sequence[P], report: FolderReport, decode: bool, titles: Sequence[str] | None = None) -> list[P]:
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
