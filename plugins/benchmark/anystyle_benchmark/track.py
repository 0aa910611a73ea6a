"""Tracks: which scenes, styles and views a benchmark has, by which metrics it judges, and the hashes of its inputs."""

import hashlib
import json
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta, Struct

from anystyle.data.images import SUFFIXES, image_size
from anystyle.errors import UserError, check_known, unknown
from anystyle.examples import resolved
from anystyle.io.documents import read_toml
from anystyle.paths import natural
from anystyle.registry.compose import choices

TRACKS = Path(__file__).parent / "tracks"
PROTOCOL = 1
"""Version of the judge: it, or that of the only track concerned, is raised whenever a figure of the same images would
come out differently."""

_Entry = TypeVar("_Entry", "SceneEntry", "StyleEntry")
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]


class SceneEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """A capture.

    Args:
        photographs: Folder of all photographs, as :meth:`Inputs.path` reads it.
        views: Stems of the photographs at whose cameras results are rendered, in the order of the capture.
        geometry: Folder with ``depth.npz`` and ``cameras.npz`` of these views, if there is one.
        title: What it shows.
        licence: Under which the photographs may be passed on.
    """

    name: Name
    photographs: str
    views: Annotated[tuple[str, ...], Meta(min_length=2)]
    geometry: str | None = None
    title: str = ""
    licence: str = ""
    source: str = ""


class StyleEntry(Struct, frozen=True, forbid_unknown_fields=True):
    """A style: an image, as :meth:`Inputs.path` reads it, or a text."""

    name: Name
    image: str | None = None
    text: str | None = None
    title: str = ""
    licence: str = ""
    source: str = ""

    @property
    def guide(self) -> str:
        """``image`` or ``text``."""
        return "text" if self.image is None else "image"


class Track(Struct, frozen=True, forbid_unknown_fields=True):
    """What every method of a benchmark is given, and how it is judged.

    Args:
        version: Raised with every change of an input or a metric; figures of different versions are never compared.
        short_side: Shorter side of the rendered views, in pixels; the other side follows the photograph, rounded.
        metrics: Names of metrics for each guide, ``image`` and ``text``.
        sha256: Hash of every input, by its path as the track writes it; without it only the hashes of the user's own
            copies are recorded, with the results.
    """

    name: Name
    version: Annotated[int, Meta(ge=1)]
    about: str
    short_side: Annotated[int, Meta(ge=16, le=4096)]
    scenes: Annotated[tuple[SceneEntry, ...], Meta(min_length=1)]
    styles: Annotated[tuple[StyleEntry, ...], Meta(min_length=1)]
    metrics: dict[Annotated[str, Meta(pattern="^(image|text)$")], tuple[str, ...]]
    sha256: dict[str, str] = msgspec.field(default_factory=dict)


class Inputs:
    """A track with its files.

    Args:
        track: The name of a bundled track, or a path of a ``track.toml``.
        root: Where its inputs lie; beside the file if not given.
    """

    def __init__(self, track: str, root: Path | None = None) -> None:
        path = Path(track) if track.endswith(".toml") else TRACKS / track / "track.toml"
        if not path.is_file() and path.parent.parent == TRACKS:
            raise UserError(unknown("track", track, sorted(file.parent.name for file in TRACKS.glob("*/track.toml"))))
        self.track: Track = read_toml(path, Track, what="track")
        self.root = path.parent if root is None else root
        for style in self.track.styles:
            if (style.image is None) == (style.text is None):
                raise UserError(f"{path}: style {style.name} needs an image or a text, and not both")
        for kind, entries in (("scene", self.track.scenes), ("style", self.track.styles)):
            names = [entry.name for entry in entries]
            if twice := [name for name in names if names.count(name) > 1]:
                raise UserError(f"{path}: two {kind}s are named {twice[0]}")
        for metric in (name for names in self.track.metrics.values() for name in names):
            if metric not in choices("metric"):
                raise UserError(f"{path}: {unknown('metric', metric, choices('metric'))}")
        self.file, self.bundled = path, path.is_relative_to(TRACKS)

    def scene(self, name: str) -> SceneEntry:
        """The scene of a name."""
        return _named("scene", name, self.track.scenes)

    def style(self, name: str) -> StyleEntry:
        """The style of a name."""
        return _named("style", name, self.track.styles)

    def path(self, written: str) -> Path:
        """The file or folder that a track names: relative to its root, or ``example:NAME``."""
        path = resolved(Path(written))
        return path if path.is_absolute() else self.root / path

    def photographs(self, scene: SceneEntry) -> dict[str, Path]:
        """All photographs of a scene by their stems, in order."""
        folder = self.path(scene.photographs)
        files = [file for file in folder.glob("*") if file.suffix.lower() in SUFFIXES] if folder.is_dir() else []
        found = {file.stem: file for file in sorted(files, key=lambda file: natural(file.name))}
        if absent := [view for view in scene.views if view not in found]:
            raise UserError(f"the track's scene {scene.name} lacks the photograph {absent[0]} in {folder}")
        return found

    def size(self, scene: SceneEntry) -> tuple[int, int]:
        """Height and width of a scene's judged images: even, in the proportion of its first judged photograph."""
        width, height = image_size(self.photographs(scene)[scene.views[0]])
        scale = self.track.short_side / min(width, height)
        return round(height * scale / 2) * 2, round(width * scale / 2) * 2

    def files(self) -> Iterator[tuple[str, Path]]:
        """Every file that methods or the judge are given, after its path as the track writes it."""
        for scene in self.track.scenes:
            for file in self.photographs(scene).values():
                yield f"{scene.photographs}/{file.name}", file
            if scene.geometry is not None:
                folder = self.path(scene.geometry)
                if not folder.is_dir():
                    raise UserError(f"there is no folder {folder} with the depth and the cameras of {scene.name}")
                yield from ((f"{scene.geometry}/{file.name}", file) for file in sorted(folder.iterdir()))
        yield from ((style.image, self.path(style.image)) for style in self.track.styles if style.image is not None)

    @cached_property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of every input; a UserError if one is missing, or is not the track's."""
        files = dict(self.files())
        if absent := [file for file in files.values() if not file.is_file()]:
            raise UserError(f"the track {self.track.name} lacks {absent[0]}")
        found = {name: hashlib.sha256(file.read_bytes()).hexdigest() for name, file in files.items()}
        if self.track.sha256 and found != self.track.sha256:
            wrong = sorted(name for name, _ in found.items() ^ self.track.sha256.items())
            raise UserError(
                f"{wrong[0]} is not the file of track {self.track.name} version {self.track.version}; "
                "changed inputs need another version"
            )
        return found

    @cached_property
    def digest(self) -> str:
        """What a figure belongs to: the track, its inputs and the version of the judge."""
        described = [msgspec.to_builtins(self.track), self.hashes, PROTOCOL]
        return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()


def _named(kind: str, name: str, entries: tuple[_Entry, ...]) -> _Entry:
    found = {entry.name: entry for entry in entries}
    check_known(kind, [name], found)
    return found[name]
