"""Known cameras, such as those stored beside photographs, and placing them in the frame of a scene."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from anystyle.contracts import StoredCamera
from anystyle.data.folder import image_files, read_picture
from anystyle.data.images import to_tensor
from anystyle.data.poses import read_poses, readers, unread, view_camera
from anystyle.errors import UserError, listing
from anystyle.geometry.transforms import Similarity
from anystyle.paths import short_names
from anystyle.pipeline.encode import ReadViews, scene_from_known
from anystyle.pipeline.options import PoseOptions
from anystyle.types import Cameras, SourceImage, Views

_log = logging.getLogger(__name__)

MAX_ASPECT_ERROR = 0.02
"""A stored camera's image may differ by this fraction from the photograph's aspect."""


@dataclass(frozen=True)
class KnownCameras:
    """Cameras in a frame and unit of their own.

    Args:
        views: Those of input views.
        indices: Which input view each of them belongs to.
        targets: Every stored camera, those of input views too.
        names: Names of the targets.
    """

    views: Cameras
    indices: tuple[int, ...]
    targets: Cameras
    names: tuple[str, ...]

    def targets_in_scene(self, predicted: Cameras) -> tuple[Cameras, Similarity]:
        """The targets in the frame of predicted cameras, and the similarity from their own frame to it."""
        poses = predicted.world_from_camera[0, list(self.indices)]
        similarity = scene_from_known(self.views.world_from_camera[0].to(poses), poses)
        targets = self.targets.to(poses.device)
        return replace(targets, world_from_camera=similarity.poses(targets.world_from_camera)), similarity


def from_views(cameras: Cameras | None, names: Sequence[str]) -> KnownCameras:
    """The cameras that a source of scenes stores for its views."""
    if cameras is None:
        raise UserError("this source knows no cameras of its scenes; use poses=predicted")
    return KnownCameras(cameras, tuple(range(len(names))), cameras, tuple(names))


def from_files(
    views: Views,
    sources: Sequence[SourceImage],
    folder: Path | None = None,
    stored: Mapping[Path, StoredCamera] | None = None,
) -> tuple[Views, tuple[SourceImage, ...], KnownCameras]:
    """The cameras stored beside photographs, and the views and sources undistorted where lenses distort them.

    ``folder`` holds the cameras; the photographs' own folders and the ones above unless it is given. ``stored`` are
    those of :func:`stored_beside`, where they were read already.
    """
    folders = {source.path.parent: None for source in sources if source.path is not None}
    stored = stored or _stored(folders, folder)
    if not stored:
        if folder is None and (told := unread(folders)):
            raise UserError(told)
        searched = f"in {folder}" if folder is not None else "beside the photographs"
        expected = ", ".join(reader.expects for reader in readers())
        known = f"expected one of: {expected}; or use poses=sfm or poses=predicted"
        raise UserError(f"no cameras are stored {searched}; {known}")
    images, undistorted, matched = views.images.clone(), list(sources), {}
    for index, source in enumerate(sources):
        if source.path is None or (camera := stored.get(source.path)) is None:
            continue
        matched[index] = _check(camera, source)
        if camera.undistortion is not None:
            apply = camera.undistortion.apply
            picture, undistorted[index] = read_picture(source.path, source.name, source.view_size, apply)
            images[0, index] = to_tensor(picture)
    if not matched:
        raise UserError("none of the photographs has a stored camera; use poses=sfm or poses=predicted")
    seen = [view_camera(_straight(camera), undistorted[index]) for index, camera in matched.items()]
    targets = [
        view_camera(_straight(camera), SourceImage.covering(path.stem, camera.size, sources[0].view_size))
        for path, camera in stored.items()
    ]
    names = tuple(short_names([path.with_suffix("") for path in stored]))
    known = KnownCameras(Cameras.cat(seen, dim=1), tuple(matched), Cameras.cat(targets, dim=1), names)
    return replace(views, images=images), tuple(undistorted), known


def with_stored(given: ReadViews, poses: PoseOptions, stored: Mapping[Path, StoredCamera] | None = None) -> ReadViews:
    """Views with the cameras that are stored for them, where these are asked for."""
    if poses.use not in ("known", "target"):
        return given
    views, sources = given.views, given.sources
    names = [source.name for source in sources]
    if sources[0].path is None:
        known = from_views(views.cameras, names)
    else:
        views, sources, known = from_files(views, sources, None if poses.folder is None else Path(poses.folder), stored)
    if poses.use == "target":
        return replace(given, views=views, sources=sources, targets=known)
    if without := [name for index, name in enumerate(names) if index not in known.indices]:
        told = "%d of %d photographs have no stored camera and are left out: %s"
        _log.warning(told, len(without), len(names), listing(without))
    kept = list(known.indices)
    return replace(
        given, views=views.select(kept), sources=tuple(sources[index] for index in kept), cameras=known.views
    )


def stored_beside(photographs: Sequence[Path], folder: Path | None = None) -> dict[Path, StoredCamera]:
    """The cameras that are stored for photographs, as :func:`from_files` finds them; empty where there are none."""
    stored = _stored({path.parent: None for path in photographs}, folder)
    return {path: stored[path] for path in photographs if path in stored}


def _straight(camera: StoredCamera) -> StoredCamera:
    """The camera of the undistorted photograph."""
    return camera if camera.undistortion is None else replace(camera, intrinsics=camera.undistortion.intrinsics)


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
