"""Cameras stored beside photographs."""

import logging
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path

import torch

from anystyle.contracts import CameraReader, StoredCamera
from anystyle.data.names import differences, matched
from anystyle.errors import UserError
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, SourceImage

_log = logging.getLogger(__name__)

UNREAD: Mapping[str, str] = tomllib.loads(Path(__file__).with_name("unread.toml").read_text("utf-8"))
"""Cameras that are not read, by a pattern of file names."""
_INSIDE = ("cams", "opensfm", "pose", "poses", "sfm")
_HOLDS = {"*.xmp": b"capturingreality", "*.xml": b"<sensors"}
"""What tells such a file from others of its name: XMP files also say how a photograph was developed."""


def readers() -> list[CameraReader]:
    """All readers of the catalog, by rank."""
    return sorted((build(CameraReader, name) for name in catalog().names("cameras")), key=lambda reader: reader.rank)


def view_camera(camera: StoredCamera, source: SourceImage) -> Cameras:
    """A stored camera as that of one view, for the part of its source that the view shows."""
    intrinsics = source.view_intrinsics(torch.from_numpy(camera.for_size(*source.size)))
    pose = torch.from_numpy(camera.world_from_camera)
    return Cameras(pose.float()[None, None], intrinsics.float()[None, None], source.view_size)


def read_poses(folder: Path, images: Sequence[Path], stored_in: str | None = None) -> dict[Path, StoredCamera]:
    """The cameras of a scene's images; empty where none are stored.

    Images may lie in another folder than the one that the cameras name, and in another resolution. ``stored_in`` is
    the file or folder with the cameras, below ``folder``; ``None`` looks for one.
    """
    target = folder if stored_in is None else folder / stored_in
    for reader in readers():
        if (path := reader.find(target)) is not None:
            stored = reader.read(path, images)
            names = matched(stored, images)
            if not names:
                raise UserError(f"{path} names none of the photographs beside it")
            if told := differences(names):
                _log.warning("%s: %s", path, told)
            return {image: stored[name] for image, name in names.items()}
    if stored_in is None:
        return {}
    raise UserError(f"{target} is not there, or holds no cameras; cameras= is relative to each scene's folder")


def unread(folders: Iterable[Path]) -> str | None:
    """A line on cameras in, beside or above the folders of photographs that are not found or not read there."""
    given = list(dict.fromkeys(folder.absolute() for folder in folders))
    inside = [path for folder in given for path in sorted(folder.glob("[!.]*")) if path.is_dir()]
    for path in (reader.find(each) for each in inside for reader in readers()):
        if path is not None:
            return f"there are cameras in {path}; poses=known poses_from={path} uses them"
    above = (place / name for each in given for place in (each, *each.parents[:2]) for name in ("", *_INSIDE))
    for each, (pattern, advice) in product(dict.fromkeys((*above, *inside)), UNREAD.items()):
        holds = _HOLDS.get(pattern, b"")
        if path := next((file for file in each.glob(pattern) if not holds or holds in file.read_bytes()), None):
            return f"the cameras in {path} are not read: {advice}; poses=known poses_from=PATH reads the result"
    return None


def stored_cameras(folder: Path) -> dict[str, StoredCamera]:
    """All cameras that are stored in a folder, by the names of images as they are stored; empty where none are."""
    found = ((reader, reader.find(folder)) for reader in readers())
    return next((dict(reader.read(path, ())) for reader, path in found if path is not None), {})
