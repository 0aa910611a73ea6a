"""Published data sets converted to what the loaders read: existing files are kept, and nothing is downloaded."""

import io
import json
import logging
import shutil
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import count
from math import isfinite
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import torch
from av.error import FFmpegError
from PIL import Image

from anystyle.data.captions import captions_file, read_captions
from anystyle.data.folder import image_files
from anystyle.data.images import SUFFIXES, image_size, open_image
from anystyle.errors import UserError, one_line
from anystyle.evaluation.paper_folder import NUM_STYLES, SCENES
from anystyle.io import video
from anystyle.io.atomic import PARTIAL, atomic_path, write_json
from anystyle.io.documents import kept_json, read_text
from anystyle.types import OnProgress, Progress
from anystyle_datasets.checking import exported, packed, same_pictures, unindexed
from anystyle_datasets.files import caption_row, pictures_below, write_lines
from anystyle_datasets.wikiart import DESCRIPTIONS, PAINTINGS, TEST_FILES, read_list

log = logging.getLogger(__name__)
S = TypeVar("S", Path, str)

ARCHIVE = "evaluation_and_splits.zip"
"""The archive of AnyStyle's authors: scenes and styles of their tables, descriptions, and the list of test styles."""
DESCRIBED = "style_descriptions.txt"
CHUNK = 100_000_000
"""Bytes of frames in a chunk of RealEstate10K, about."""
SHORT_SIDE = 360
"""Frames of RealEstate10K are stored with this shorter side at most, in pixels."""
SIDE = 448
"""Photographs of the tables are taken where their shorter side has this many pixels, if they come in several sizes."""


def dl3dv(root: Path, on_progress: OnProgress) -> str:
    """Unpack the scenes of DL3DV that are still packed, and write ``train_index.json``.

    Scenes that ``test_index.json`` names, if there is one, are not in it.
    """
    archives = packed(root)
    for number, path in enumerate(archives):
        on_progress(Progress.count("unpacking", number, len(archives)))
        _unpack(path)
    names = [path.relative_to(root).as_posix() for path in unindexed(root)]
    held = frozenset(kept_json(root / "test_index.json", list[str]) or ())
    kept = [name for name in names if name not in held]
    if not kept:
        raise UserError(f"{root} holds no scene of DL3DV; expected folders with images_8 or images_4, at any depth")
    if kept_json(root / "train_index.json", list[str]) != kept:
        write_json(root / "train_index.json", kept)
    return f"{len(kept)} scenes in train_index.json"


def _unpack(path: Path) -> None:
    """Unpack an archive beside itself, into a folder of its name."""
    temporary = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=path.parent))
    try:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(temporary)
        inside = list(temporary.iterdir())
        content = inside[0] if len(inside) == 1 and inside[0].name == path.stem else temporary
        content.chmod(0o755)
        content.replace(path.with_suffix(""))
    except zipfile.BadZipFile as error:
        raise UserError(f"{path} is not an archive, or is damaged ({one_line(error)}); get it again") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def re10k(root: Path, on_progress: OnProgress) -> str:
    """Write chunks of frames and cameras for the camera lists ``{train,test}/CLIP.txt`` of RealEstate10K.

    A list has an address in its first line, then a line per frame: time in microseconds and the 18 numbers of a chunk's
    camera. Frames are ``frames/CLIP/TIME.jpg`` (or ``frames/{train,test}/...``, or png), or are taken out of
    ``videos/ID.mp4`` by the address's ID. Clips with fewer than two frames are left out.
    """
    told: list[str] = []
    listed = made = 0
    for split in ("train", "test"):
        lists = sorted((root / split).glob("*.txt"))
        index: dict[str, str] = kept_json(root / split / "index.json", dict[str, str]) or {}
        waiting = [path for path in lists if path.stem not in index]
        clips: list[dict[str, Any]] = []
        absent = 0
        for number, path in enumerate(waiting, start=1):
            clip = _clip(root, split, path)
            absent += clip is None
            clips += [] if clip is None else [clip]
            size = sum(len(frame) for each in clips for frame in each["images"])
            if clips and (size > CHUNK or number == len(waiting)):
                _store(root / split, clips, index)
                clips = []
            on_progress(Progress.count(f"{split}: reading clips", number, len(waiting)))
        if lists:
            told.append(f"{split}: {len(index)} of {len(lists)} clips, {absent} without frames here")
            listed, made = listed + len(lists), made + len(index)
    if not told:
        raise UserError(f"{root} holds no camera list; expected train/*.txt and test/*.txt")
    if not made:
        raise UserError(
            f"{root} holds no frame of the {listed} camera lists; expected frames/CLIP/TIME.jpg or videos/ID.mp4"
        )
    return "; ".join(told)


def _store(folder: Path, clips: Sequence[dict[str, Any]], index: dict[str, str]) -> None:
    """Write a chunk, then the index that names it."""
    path = next(path for number in count() if not (path := folder / f"{number:06d}.torch").exists())
    with atomic_path(path, sync=True) as temporary:
        torch.save(list(clips), temporary)
    index |= {clip["key"]: path.name for clip in clips}
    write_json(folder / "index.json", index)


def _clip(root: Path, split: str, path: Path) -> dict[str, Any] | None:
    address, *lines = read_text(path).splitlines()
    try:
        rows = [(int(line.split()[0]), [float(word) for word in line.split()[1:]]) for line in lines if line.strip()]
        if not all(len(numbers) == 18 and all(map(isfinite, numbers)) for _, numbers in rows):
            raise ValueError("a line that is not 19 finite numbers")
    except ValueError as error:
        raise UserError(f"{path} is not a camera list of RealEstate10K ({one_line(error)})") from None
    folders = (root / "frames" / split / path.stem, root / "frames" / path.stem)
    files = (frame for folder in folders if folder.is_dir() for frame in image_files(folder))
    stored = {int(frame.stem): frame for frame in files if frame.stem.isdecimal()}
    identity = address.rpartition("=")[2].rpartition("/")[2].strip()
    films = [file for suffix in sorted(video.SUFFIXES) if (file := root / "videos" / f"{identity}{suffix}").is_file()]
    times = [time for time, _ in rows]
    found: Iterable[tuple[int, bytes]] = ((time, _encoded(stored[time])) for time in times if time in stored)
    if not stored and films:
        found = _film(films[0], times)
    try:
        frames = dict(found)
    except (UserError, FFmpegError) as error:
        log.warning("left out: %s (%s)", path.stem, one_line(error))
        return None
    if len(frames) < 2:
        return None
    return {
        "key": path.stem,
        "url": address.strip(),
        "timestamps": torch.tensor(sorted(frames)),
        "cameras": torch.tensor([numbers for time, numbers in sorted(rows) if time in frames]),
        "images": [torch.frombuffer(bytearray(frames[time]), dtype=torch.uint8) for time in sorted(frames)],
    }


def _encoded(source: Path | Image.Image) -> bytes:
    """A frame as JPEG or as it is stored, no larger than frames are."""
    if isinstance(source, Path) and min(image_size(source)) <= SHORT_SIDE:
        return source.read_bytes()
    picture = open_image(source) if isinstance(source, Path) else source.convert("RGB")
    scale = min(1.0, SHORT_SIDE / min(picture.size))
    small = picture.resize((round(picture.width * scale), round(picture.height * scale)), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=95)
    return buffer.getvalue()


def _film(path: Path, times: Sequence[int]) -> Iterator[tuple[int, bytes]]:
    """The frames of a video at times in microseconds, each the first that is no more than half a frame earlier."""
    waiting = sorted(times, reverse=True)
    with video.opened(path) as container:
        if not container.streams.video:
            raise UserError(f"{path} has no video in it")
        stream = container.streams.video[0]
        half = 500_000 / float(stream.average_rate or Fraction(30))
        container.seek(max(0, waiting[-1] - 1_000_000))
        for frame in container.decode(stream):
            while waiting and frame.time is not None and frame.time * 1e6 >= waiting[-1] - half:
                yield waiting.pop(), _encoded(frame.to_image())
            if not waiting:
                return


def wikiart(
    root: Path,
    on_progress: OnProgress,
    *,
    archive: Path | None = None,
    stylos: Path | None = None,
    styl3r: Path | None = None,
) -> str:
    """Make WikiArt's paintings, its descriptions and its list of test styles, which no training draws.

    Tables of the hub's export are unpacked into folders of movements. Descriptions and list come from the authors'
    archive where it is given. Paintings that show the same as a picture of the folders ``stylos`` and ``styl3r`` are
    added to the list; what was found stays in ``test_NAME.txt`` and is not sought again.
    """
    _unpack_tables(root, on_progress)
    if not any(path.suffix.lower() in PAINTINGS for path in root.glob("*/*")):
        raise UserError(f"{root} holds no painting; expected MOVEMENT/NAME.jpg, or data/*.parquet")
    taken = _take(archive, {DESCRIPTIONS: root / DESCRIPTIONS, TEST_FILES: root / TEST_FILES})
    before = set(read_list(root / TEST_FILES) if (root / TEST_FILES).is_file() else ())
    held = set(before)
    for name, folder in (("stylos", stylos), ("styl3r", styl3r)):
        if folder is None:
            continue
        record = root / f"test_{name}.txt"
        if not record.is_file():
            others = pictures_below(folder)
            if not others:
                raise UserError(f"--{name} {folder}: there are no pictures in it")
            stage = f"looking for the pictures of {folder}"
            found = same_pictures(pictures_below(root, PAINTINGS), others, stage, on_progress)
            write_lines(record, (path.relative_to(root).as_posix() for path in found))
        held.update(read_list(record))
    if held != before:
        write_lines(root / TEST_FILES, sorted(held))
    missing = [name for name in (DESCRIPTIONS, TEST_FILES) if not (root / name).is_file()]
    return f"taken from the archive: {', '.join(taken) or 'nothing'}; {len(held)} test styles" + (
        f"; still missing: {', '.join(missing)}" if missing else ""
    )


def _unpack_tables(root: Path, on_progress: OnProgress) -> None:
    tables = exported(root)
    if not tables:
        return
    try:
        from pyarrow import parquet  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise ImportError('tables of paintings need pyarrow; pip install "anystyle[parquet]"') from None
    for number, path in enumerate(tables, start=1):
        try:
            table = parquet.ParquetFile(path)
        except (OSError, ValueError) as error:
            raise UserError(f"{path} is not a parquet file, or is damaged ({one_line(error)})") from None
        about = json.loads((table.schema_arrow.metadata or {}).get(b"huggingface", "{}"))
        features = about.get("info", {}).get("features", {})
        if not all("names" in features.get(label, {}) for label in ("artist", "style")):
            raise UserError(f"{path} is not a table of paintings with an artist and a style for each")
        for group in range(table.num_row_groups):
            rows = table.read_row_group(group, columns=["artist", "style", "image.path"]).to_pylist()
            targets: list[Path] = []
            for place, row in enumerate(rows):
                artist, style = (features[label]["names"][row[label]] for label in ("artist", "style"))
                name = row["image"]["path"] or f"{artist}_{path.stem}-{group}-{place}.jpg"
                targets.append(root / PurePosixPath(style).name / PurePosixPath(name).name)
            if not all(target.is_file() for target in targets):
                images = table.read_row_group(group, columns=["image.bytes"]).to_pylist()
                for target, row in zip(targets, images, strict=True):
                    with atomic_path(target) as temporary:
                        temporary.write_bytes(row["image"]["bytes"])
        on_progress(Progress.count("unpacking tables of paintings", number, len(tables)))


def styles(root: Path, on_progress: OnProgress) -> str:
    """Write ``captions.jsonl`` with a line for each picture of a folder of styles, empty where nothing describes it."""
    paths = image_files(root)
    if not paths:
        raise UserError(f"{root}: there are no pictures in it")
    file = captions_file(root)
    known = read_captions(file) if file else {}
    if file is None or any(path.name not in known for path in paths):
        write_lines(root / "captions.jsonl", (caption_row(path.name, known.get(path.name, "")) for path in paths))
    return f"{sum(bool(known.get(path.name)) for path in paths)} of {len(paths)} pictures have a text"


def tables(
    root: Path,
    on_progress: OnProgress,
    *,
    archive: Path | None = None,
    captures: Sequence[Path] = (),
    stylos: Path | None = None,
) -> str:
    """Lay out the folder of the paper's tables: from the authors' archive, or from captures and test styles.

    Photographs are copied in natural order, all of a scene: of ``images_4``, where a capture has several sizes and that
    one is large enough or the only one, else of ``images`` or the capture's folder itself. A folder that holds other
    pictures is kept.
    """
    if not (archive or captures or stylos):
        raise UserError(f"give --archive {ARCHIVE}, or --captures FOLDER ... and --stylos FOLDER")
    copies = {path: root / "styles" / path.name for path in (image_files(stylos)[:NUM_STYLES] if stylos else [])}
    if stylos and not copies:
        raise UserError(f"--stylos {stylos}: there are no pictures in it")
    num_styles = len(copies)
    for scene in SCENES:
        found = (path for folder in captures for path in folder.rglob("*") if path.is_dir())
        capture = next((path for path in found if path.name.casefold() == scene.casefold()), None)
        copies |= {path: root / "content" / scene / path.name for path in (_photographs(capture) if capture else [])}
    if captures and len(copies) == num_styles:
        raise UserError(f"--captures {' '.join(map(str, captures))}: holds none of {', '.join(SCENES)}")
    copies = _unmixed(copies)
    left = {source: target for source, target in copies.items() if not target.is_file()}
    for number, (source, target) in enumerate(left.items(), start=1):
        with atomic_path(target) as temporary:
            shutil.copyfile(source, temporary)
        if number % 50 == 0 or number == len(left):
            on_progress(Progress.count("copying", number, len(left)))
    taken = _take(
        archive, {DESCRIBED: root / DESCRIBED}, {"content": root / "content", "style_images": root / "styles"}
    )
    absent = ", ".join(scene for scene in SCENES if not (root / "content" / scene).is_dir())
    return f"{len(copies) + len(taken)} files laid out" + (f"; nothing of {absent}" if absent else "")


def _photographs(capture: Path) -> list[Path]:
    small: list[Path] = []
    for name in ("images_4", "images", "."):
        paths = image_files(capture / name) if (capture / name).is_dir() else []
        if paths and (name != "images_4" or min(image_size(paths[0])) >= SIDE):
            return paths
        small = small or paths
    return small


def _take(archive: Path | None, files: dict[str, Path], folders: dict[str, Path] | None = None) -> list[str]:
    """Copy files out of the archive by their name, and whole folders by theirs, wherever they lie in it."""
    if archive is None:
        return []
    try:
        with zipfile.ZipFile(archive) as opened:
            targets: dict[str, Path] = {}
            for member in opened.infolist():
                parts = PurePosixPath(member.filename).parts
                target = files.get(parts[-1]) if parts else None
                for name, folder in (folders or {}).items():
                    if name in parts[:-1] and PurePosixPath(parts[-1]).suffix.lower() in SUFFIXES:
                        inside = parts[parts.index(name) + 1 :]
                        target = folder.joinpath(*inside) if ".." not in inside else None
                if not member.is_dir() and target is not None and "__MACOSX" not in parts:
                    targets[member.filename] = target
            if not targets:
                raise UserError(f"--archive {archive} holds none of {', '.join([*files, *(folders or {})])}")
            targets = _unmixed(targets)
            for name, target in targets.items():
                if not target.is_file():
                    with atomic_path(target) as temporary:
                        temporary.write_bytes(opened.read(name))
    except (OSError, zipfile.BadZipFile) as error:
        raise UserError(f"--archive {archive} is not an archive, or is damaged ({one_line(error)})") from None
    return [PurePosixPath(name).name for name in targets]


def _unmixed(targets: Mapping[S, Path]) -> dict[S, Path]:
    """What goes to folders without other pictures: tables judge the first of a folder, whosever they are."""
    names: dict[Path, set[str]] = {}
    for target in targets.values():
        names.setdefault(target.parent, set()).add(target.name)
    folders = [folder for folder in names if folder.is_dir()]
    mixed = {folder for folder in folders if any(path.name not in names[folder] for path in image_files(folder))}
    for folder in sorted(mixed):
        log.warning("%s is kept as it is: it holds other pictures", folder)
    return {source: target for source, target in targets.items() if target.parent not in mixed}
