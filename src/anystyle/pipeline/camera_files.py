"""Cameras stored beside photographs, matched with the views."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from anystyle.contracts import StoredCamera
from anystyle.data.folder import covering, image_files, read_picture
from anystyle.data.images import to_tensor
from anystyle.data.names import short_names
from anystyle.data.poses import read_poses, readers, view_camera
from anystyle.errors import UserError
from anystyle.pipeline.cameras import KnownCameras
from anystyle.types import Cameras, SourceImage, Views

MAX_ASPECT_ERROR = 0.02
"""A stored camera's image may differ by this fraction from the photograph's aspect."""


def from_files(
    views: Views, sources: Sequence[SourceImage], folder: Path | None = None
) -> tuple[Views, tuple[SourceImage, ...], KnownCameras]:
    """The cameras stored beside photographs, and the views and sources undistorted where lenses distort them.

    Args:
        views: Of the photographs.
        sources: The photographs, read from files.
        folder: Holds the cameras; the photographs' own folders and the ones above unless it is given.
    """
    stored = _stored({source.path.parent: None for source in sources if source.path is not None}, folder)
    if not stored:
        searched = f"in {folder}" if folder is not None else "beside the photographs"
        expected = ", ".join(reader.expects for reader in readers())
        raise UserError(f"no cameras are stored {searched}; expected one of: {expected}; or use poses=predicted")
    images, undistorted = views.images.clone(), list(sources)
    for index, source in enumerate(sources):
        camera = None if source.path is None else stored.get(source.path)
        if source.path is not None and camera is not None and camera.undistortion is not None:
            _check(camera, source)
            apply = camera.undistortion.apply
            picture, undistorted[index] = read_picture(source.path, source.name, source.view_size, apply)
            images[0, index] = to_tensor(picture)
    stored = {
        path: camera if camera.undistortion is None else replace(camera, intrinsics=camera.undistortion.intrinsics)
        for path, camera in stored.items()
    }
    matched = [
        (index, source, stored[source.path])
        for index, source in enumerate(undistorted)
        if source.path is not None and source.path in stored
    ]
    if not matched:
        raise UserError("none of the photographs has a stored camera; use poses=predicted")
    size = sources[0].view_size
    targets = [view_camera(camera, covering(path.stem, camera.size, size)) for path, camera in stored.items()]
    known = KnownCameras(
        views=Cameras.cat([view_camera(_check(camera, source), source) for _, source, camera in matched], dim=1),
        indices=tuple(index for index, _, _ in matched),
        targets=Cameras.cat(targets, dim=1),
        names=tuple(short_names([path.with_suffix("") for path in stored])),
    )
    return replace(views, images=images), tuple(undistorted), known


def _stored(photographs: Iterable[Path], given: Path | None) -> dict[Path, StoredCamera]:
    """The cameras of the photographs in some folders, each from the first folder from it upwards that holds any."""
    images: dict[Path, list[Path]] = {}
    for folder in photographs:
        above = (folder, *folder.absolute().parents[:2]) if given is None else (given,)
        place = next((each for each in above if any(reader.find(each) for reader in readers())), None)
        if place is not None:
            images.setdefault(place.absolute(), []).extend(image_files(folder))
    return {path: camera for place, files in images.items() for path, camera in read_poses(place, files).items()}


def _check(camera: StoredCamera, source: SourceImage) -> StoredCamera:
    """The camera, if its image has the photograph's aspect."""
    (height, width), (stored_height, stored_width) = source.size, camera.size
    if abs(width * stored_height / (height * stored_width) - 1) > MAX_ASPECT_ERROR:
        raise UserError(
            f"the stored camera of {source.name} is for an image of {stored_width}x{stored_height} pixels, and the "
            f"photograph has {width}x{height}; give the poses of these photographs"
        )
    return camera
