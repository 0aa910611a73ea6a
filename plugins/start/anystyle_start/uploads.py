"""Uploads: files come in parts, are checked before they are kept, and get small pictures."""

import re
import shutil
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, Literal

from PIL import Image

from anystyle.data import images
from anystyle.data.names import distinct
from anystyle.errors import UserError
from anystyle.io import video
from anystyle.io.atomic import atomic_path
from anystyle.registry.catalog import catalog
from anystyle_start.library import ACTIVE, Kind, Library, Record

PART = 8 << 20
"""The largest part of a file in bytes."""
LIMITS: dict[str, int] = {"photographs": 200 << 20, "film": 8 << 30, "splat": 4 << 30}
"""The largest file of a kind in bytes."""
MAX_FILES = 320
"""Photographs of a scene: as many as are read."""
FRAMES = 12
"""Small pictures of a film."""
SIDE = 480
"""The longer side of small pictures in pixels."""
_UPLOAD = re.compile(r"[0-9a-z]{1,32}")
_NAMES: dict[Kind, str] = {"photographs": "photographs", "film": "a film", "splat": "a splat"}
Uploaded = Literal["photographs", "film", "splat"]


def suffixes() -> dict[Uploaded, list[str]]:
    """The suffixes of files that are taken."""
    splats = [f".{name}" for name in catalog().names("format") if catalog().find("format", name).load().reads]
    return {"photographs": sorted(images.SUFFIXES), "film": sorted(video.SUFFIXES), "splat": splats}


class Uploads:
    """Receives the files of scenes."""

    def __init__(self, library: Library) -> None:
        self.library, self._lock = library, threading.Lock()
        self._kinds: dict[str, Uploaded] = {suffix: kind for kind, known in suffixes().items() for suffix in known}

    def receive(self, scene: str, name: str, upload: str, offset: int, total: int, part: BinaryIO) -> str | None:
        """Append a part of a file of :data:`PART` bytes at most; the last one checks and stores the file.

        ``name`` is the file's, ``upload`` the same for all its parts; ``offset`` bytes came before, of ``total``.

        Returns:
            The name that the file has got, once it is whole.
        """
        kind = self._admitted(scene, name, total)
        if not _UPLOAD.fullmatch(upload):
            raise UserError("an upload without a name; load the page again")
        partial = self.library.uploads(scene) / upload
        partial.parent.mkdir(exist_ok=True)
        with partial.open("ab") as file:
            if file.tell() != offset:
                raise UserError(f"{name[:80]}: a part was lost on the way; add the file again")
            shutil.copyfileobj(part, file)
            received = file.tell()
        if received < total:
            return None
        try:
            if received > total:
                raise UserError(f"{name[:80]} is larger than was announced; add the file again")
            return self._keep(scene, name, kind, partial)
        finally:
            partial.unlink(missing_ok=True)

    def _admitted(self, scene: str, name: str, total: int) -> Uploaded:
        """The kind of a file that the scene can take."""
        kind, record = self._kinds.get(Path(name).suffix.lower()), self.library[scene]
        if kind is None:
            raise UserError(f"{name[:80]} is not a photograph, film or splat that can be read; JPEG, PNG and MP4 can")
        if not 0 < total <= LIMITS[kind]:
            raise UserError(f"{name[:80]} has {total:,} bytes; from 1 to {LIMITS[kind]:,} are taken")
        if total > shutil.disk_usage(self.library.folder).free // 2:
            raise UserError(f"{name[:80]} has {total:,} bytes, for which the disk has too little room")
        if record.job.state in ACTIVE:
            raise UserError("the scene is being made; cancel that to add files")
        if record.kind is not None and (record.kind != kind or kind != "photographs"):
            raise UserError(
                f"{name[:80]}: a scene is made of photographs, or one film, or one splat, and this one has "
                f"{_NAMES.get(record.kind, 'an example')} already"
            )
        if len(self.library.inputs(scene)) >= MAX_FILES:
            raise UserError(f"{name[:80]}: a scene takes at most {MAX_FILES} photographs")
        return kind

    def _keep(self, scene: str, name: str, kind: Uploaded, partial: Path) -> str:
        """Check a whole file, draw its small pictures, and move it to the scene's inputs."""
        named = partial.rename(partial.with_name(f"{partial.name}{Path(name).suffix.lower()}"))
        try:
            pictures = small_pictures(kind, named)
            with self._lock:  # two files that end at once may have one name
                self._admitted(scene, name, named.stat().st_size)
                folder = self.library.path(scene) / "input"
                folder.mkdir(exist_ok=True)
                stem = stem_of(name)
                final = folder / f"{distinct([*(path.stem for path in folder.iterdir()), stem], '-')[-1]}{named.suffix}"
                save_pictures(pictures, self.library.thumbnails(scene), final.name)
                named.rename(final)
                title = stem.replace("-", " ") * (kind != "photographs")
                transparent = (final.name,) if kind == "photographs" and images.open_alpha(final) else ()

                def added(record: Record) -> Record:
                    named = replace(record, kind=kind, title=record.title or title, source="")
                    return replace(named, transparent=tuple({*record.transparent, *transparent}))

                self.library.update(scene, added)
            return final.name
        except UserError as error:
            raise UserError(str(error).replace(str(named), name[:80])) from None
        finally:
            named.unlink(missing_ok=True)

    def remove(self, scene: str, name: str) -> None:
        """Remove one file of a scene."""
        with self._lock:
            if self.library[scene].job.state in ACTIVE:
                raise UserError("the scene is being made; cancel that to remove files")
            for path in self.library.inputs(scene):
                if path.name == name:
                    path.unlink()
                    for picture in self.library.thumbnails(scene).glob("*.jpg"):
                        if picture.name.rsplit(".", 2)[0] == name:
                            picture.unlink()
            if not self.library.inputs(scene):
                self.library.update(scene, lambda record: replace(record, kind=None))


def stem_of(name: str) -> str:
    """What a file is called in a scene, without suffix."""
    return re.sub(r"[^\w-]+", "-", Path(name).stem).strip("-")[:60] or "photograph"


def small_pictures(kind: str, path: Path) -> Sequence[Image.Image]:
    """Small pictures of a photograph or a film, every pixel of which is decoded: damaged files are refused."""
    if kind == "film":
        pictures = [frame for _, frame in video.read_frames(path, FRAMES)]
    else:
        pictures = [images.open_image(path, longest=2 * SIDE)] if kind == "photographs" else []
    for picture in pictures:
        picture.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    return pictures


def save_pictures(pictures: Sequence[Image.Image], folder: Path, name: str) -> None:
    """Save small pictures of a file as ``NAME.00.jpg`` and so on."""
    for index, picture in enumerate(pictures):
        with atomic_path(folder / f"{name}.{index:02d}.jpg") as path:
            picture.convert("RGB").save(path, "JPEG", quality=82)
