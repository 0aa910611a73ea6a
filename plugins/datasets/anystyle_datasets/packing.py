"""Writing scenes and styles to shards."""

import logging
import tarfile
import zlib
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from anystyle.contracts import SceneSource, StyleSource
from anystyle.data.images import image_size
from anystyle.data.stored import StoredScenes, StoredStyles
from anystyle.errors import UserError, one_line
from anystyle.io.atomic import PARTIAL, atomic_path, folder_lock, write_json
from anystyle.io.documents import kept_json
from anystyle.io.images import Picture, opened
from anystyle.types import OnProgress, Progress, no_progress
from anystyle_datasets.shards import INDEX, ROW, ROWS, SceneSample, ShardIndex, StyleSample, shard_name

logger = logging.getLogger(__name__)

BEGUN = "begun.json"
"""The index while shards are being written; each that is finished has its rows beside it."""


def pack(
    source: SceneSource | StyleSource,
    out: Path,
    *,
    options: dict[str, Any],
    megabytes: int = 1024,
    on_progress: OnProgress = no_progress,
) -> ShardIndex:
    """Write the samples of a source to shards, their pictures as they are stored.

    Finished shards are kept: an interrupted call is continued by the same call, to the same bytes. A scene that cannot
    be read stays, without views, so that scenes keep their numbers.

    Args:
        source: :class:`~anystyle.data.stored.StoredScenes`, or ``StoredStyles``.
        out: A folder.
        options: Options of the source that readers of the shards take where they are given none.
        megabytes: Size after which a shard is closed.
        on_progress: Called for each scene or style.

    Raises:
        UserError: The source's pictures are not stored, or the folder holds shards of another one.
    """
    if isinstance(source, StoredScenes):
        kind, names = "scenes", [source.name(scene) for scene in range(len(source))]
    elif isinstance(source, StoredStyles):
        kind, names = "styles", [source.stored(style).name for style in range(len(source))]
    else:
        raise UserError(f"{type(source).__name__} makes its pictures: there are no files of them to put into shards")
    index = ShardIndex(kind, names, options, megabytes)
    with folder_lock(out, f"another `anystyle data shard` is at work in {out}"):
        known = kept_json(out / INDEX, ShardIndex) or kept_json(out / BEGUN, ShardIndex)
        if _plan(known) != _plan(index) if known else any(out.glob("*.tar")):
            raise UserError(f"{out} holds shards of other samples or options; choose another folder, or remove it")
        if known and known.shards:
            return known
        for partial in out.glob(f"{PARTIAL}*"):  # of a process that was killed
            partial.unlink()
        write_json(out / BEGUN, msgspec.to_builtins(index))
        _write(out, index, source, on_progress)
    return index


def _plan(index: ShardIndex) -> tuple[Any, ...]:
    return index.version, index.kind, index.names, index.options, index.megabytes


def _write(out: Path, index: ShardIndex, source: StoredScenes | StoredStyles, on_progress: OnProgress) -> None:
    done: list[NDArray[np.void]] = []
    while (part := _part(out, len(done))).is_file() and part.with_suffix(".tar").is_file():
        done.append(np.load(part))
    group = int(done[-1]["group"][-1]) if done else 0
    # A scene may begin in one shard and end in the next.
    skipped = sum(int((rows["group"] == group).sum()) for rows in done)
    left = islice(_samples(source, group, on_progress), skipped, None)
    for first in left:
        done.append(_shard(out / shard_name(len(done)), len(done), chain([first], left), index.megabytes << 20))
        with atomic_path(_part(out, len(done) - 1), sync=True) as temporary:
            np.save(temporary, done[-1])
    if not done:
        raise UserError(f"none of {len(index.names)} {index.kind} can be read")
    with atomic_path(out / ROWS, sync=True) as temporary:
        np.save(temporary, np.concatenate(done))
        index.crc = zlib.crc32(temporary.read_bytes())
    index.shards = [(out / shard_name(number)).stat().st_size for number in range(len(done))]
    write_json(out / INDEX, msgspec.to_builtins(index))
    for path in (out / BEGUN, *(_part(out, number) for number in range(len(done)))):
        path.unlink()


def _part(out: Path, number: int) -> Path:
    """The rows of a shard, which are there when it is finished."""
    return (out / shard_name(number)).with_suffix(".npy")


class _Sample(NamedTuple):
    group: int
    number: int
    about: msgspec.Struct
    picture: Picture | None


def _samples(source: StoredScenes | StoredStyles, first: int, on_progress: OnProgress) -> Iterator[_Sample]:
    """The samples of all groups, from ``first`` on."""
    for group in range(first, len(source)):
        on_progress(Progress.count("packing", group, len(source)))
        for number, (about, picture) in enumerate(_group(source, group)):
            yield _Sample(group, number, about, picture)
    on_progress(Progress.count("packing", len(source), len(source)))


def _group(source: StoredScenes | StoredStyles, group: int) -> Iterator[tuple[msgspec.Struct, Picture | None]]:
    if isinstance(source, StoredStyles):
        picture, text, name = source.stored(group)
        yield StyleSample(name, text), picture
        return
    try:
        shots = source.shots(group)
    except UserError as error:
        logger.warning("%s is packed without views: %s", source.name(group), one_line(error))
        return
    for view, (picture, name) in enumerate(zip(shots.pictures, shots.names, strict=True)):
        about = SceneSample(name)
        if shots.cameras:
            camera = shots.cameras[view]
            about = SceneSample(name, camera.world_from_camera.tolist(), camera.intrinsics.tolist(), camera.size)
        yield about, picture


def _shard(path: Path, number: int, samples: Iterable[_Sample], limit: int) -> NDArray[np.void]:
    """Write samples until the shard has ``limit`` bytes; the result is their rows."""
    rows: list[tuple[int, ...]] = []
    with atomic_path(path, sync=True) as temporary, temporary.open("wb") as file:
        for group, index, about, picture in samples:
            key, text = f"{group:06d}/{index:06d}", msgspec.json.encode(about)
            members, end, position, size = _member(f"{key}.json", text), len(text), 0, (0, 0)
            if picture is not None:
                content = picture if isinstance(picture, bytes) else picture.read_bytes()
                suffix, size = _kind(content, f"{key} of {path.name}")
                position, end = len(members), len(members) + len(content)
                members += _member(f"{key}.{suffix}", content)
            begin = tarfile.BLOCKSIZE
            crc = zlib.crc32(members[begin : begin + end])
            rows.append((group, number, file.tell() + begin, end, len(text), position, crc, *size))
            file.write(members)
            if file.tell() >= limit:
                break
        file.write(bytes(2 * tarfile.BLOCKSIZE))  # the end of an archive
    return np.array(rows, ROW)


def _member(name: str, content: bytes) -> bytes:
    """A file as a tar archive holds it: a header of one block, and blocks of content."""
    about = tarfile.TarInfo(name)
    about.size = len(content)
    return about.tobuf(tarfile.USTAR_FORMAT) + content + bytes(-len(content) % tarfile.BLOCKSIZE)


def _kind(content: bytes, name: str) -> tuple[str, tuple[int, int]]:
    """The suffix of an image, its width and height; other content is kept, and skipped where it is read."""
    try:
        with opened(content, name) as image:
            suffix = (image.format or "bin").lower()
        return suffix, image_size(content, name)
    except UserError as error:
        logger.warning("packed as it is: %s", one_line(error))
        return "bin", (0, 0)
