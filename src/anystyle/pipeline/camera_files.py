"""Cameras stored beside photographs, matched with the views."""

from collections.abc import Sequence
from pathlib import Path

from anystyle.data.folder import SourceImage, covering, image_files
from anystyle.data.poses import StoredCamera, read_poses, view_camera
from anystyle.errors import UserError
from anystyle.pipeline.cameras import KnownCameras
from anystyle.types import Cameras

MAX_ASPECT_ERROR = 0.02
"""A stored camera's image may differ by this fraction from the photograph's aspect."""


def from_files(sources: Sequence[SourceImage], folder: Path | None = None) -> KnownCameras:
    """The cameras stored beside photographs: COLMAP's model, ``transforms.json`` or ``poses_bounds.npy``.

    Args:
        sources: The photographs, read from files.
        folder: Holds the cameras; the photographs' own folders and the ones above unless it is given.
    """
    stored: dict[Path, StoredCamera] = {}
    for parent in dict.fromkeys(source.path.parent for source in sources if source.path is not None):
        stored |= _stored(parent, [folder] if folder is not None else [parent, parent.absolute().parent])
    if not stored:
        searched = f"in {folder}" if folder is not None else "beside the photographs"
        raise UserError(
            f"no cameras are stored {searched}; expected a COLMAP model, transforms.json or poses_bounds.npy, or use "
            "poses=predicted"
        )
    matched = [
        (index, source, stored[source.path])
        for index, source in enumerate(sources)
        if source.path is not None and source.path in stored
    ]
    if not matched:
        raise UserError("none of the photographs has a stored camera; use poses=predicted")
    size = sources[0].view_size
    targets = [_camera(camera, covering(path.stem, camera.size, size)) for path, camera in stored.items()]
    return KnownCameras(
        views=Cameras.cat([_camera(camera, source) for _, source, camera in matched], dim=1),
        indices=tuple(index for index, _, _ in matched),
        targets=Cameras.cat(targets, dim=1),
        names=tuple(path.stem for path in stored),
    )


def _stored(photographs: Path, folders: Sequence[Path]) -> dict[Path, StoredCamera]:
    """The cameras of a folder's photographs, from the first of some folders that holds any."""
    images = image_files(photographs)
    for folder in folders:
        if cameras := read_poses(folder, [path.name for path in images]):
            return {path: cameras[path.name] for path in images if path.name in cameras}
    return {}


def _camera(camera: StoredCamera, source: SourceImage) -> Cameras:
    (height, width), (stored_height, stored_width) = source.size, camera.size
    if abs(width * stored_height / (height * stored_width) - 1) > MAX_ASPECT_ERROR:
        raise UserError(
            f"the stored camera of {source.name} is for an image of {stored_width}x{stored_height} pixels, and the "
            f"photograph has {width}x{height}; give the poses of these photographs"
        )
    return view_camera(camera, source)
