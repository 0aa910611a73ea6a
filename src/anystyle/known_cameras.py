"""Cameras that somebody knows already: found beside photographs, matched with the views, placed in their scene."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from anystyle.data.folder import SourceImage, covering, natural
from anystyle.data.images import SUFFIXES
from anystyle.data.poses import StoredCamera, read_poses
from anystyle.geometry.alignment import Similarity, similarity_of_cameras
from anystyle.types import Cameras

ASPECT = 0.02
"""A stored camera's image may differ by so much from the photograph's aspect."""


@dataclass(frozen=True)
class KnownCameras:
    """Cameras in a frame and unit of their own.

    Args:
        views: Those of input views.
        places: Which input view each of them belongs to.
        targets: Every stored camera, those of input views too.
        names: Of the targets.
    """

    views: Cameras
    places: tuple[int, ...]
    targets: Cameras
    names: tuple[str, ...]

    def of_all(self, names: Sequence[str]) -> Cameras:
        """The cameras of all input views, in their order.

        Raises:
            ValueError: Some have none.
        """
        without = [name for place, name in enumerate(names) if place not in self.places]
        if without:
            shown = ", ".join(without[:5])
            raise ValueError(
                f"{len(without)} of {len(names)} photographs have no stored camera ({shown}); leave them out, or use "
                "poses=target"
            )
        return self.views

    def placed(self, predicted: Cameras) -> tuple[Cameras, Similarity]:
        """The targets in the frame of predicted cameras, and the way there.

        Args:
            predicted: Of all input views.

        Raises:
            ValueError: Known and predicted cameras have nothing in common.
        """
        chosen = predicted.world_from_camera[0, list(self.places)]
        change = similarity_of_cameras(self.views.world_from_camera[0].to(chosen), chosen)
        if not bool(change.scale > 1e-9):
            raise ValueError(
                "the known poses do not match the images: they move the other way from what the images show; check "
                "that they are in the images' order, or use poses=predicted"
            )
        pose = change.moved(self.targets.world_from_camera[0].to(chosen))[None]
        return replace(self.targets, world_from_camera=pose, intrinsics=self.targets.intrinsics.to(chosen)), change


def from_views(cameras: Cameras | None, names: Sequence[str]) -> KnownCameras:
    """What a source of scenes knows of its views.

    Raises:
        ValueError: It knows no cameras.
    """
    if cameras is None:
        raise ValueError("this source knows no cameras of its scenes; use poses=predicted")
    return KnownCameras(cameras, tuple(range(len(names))), cameras, tuple(names))


def from_files(sources: Sequence[SourceImage], where: Path | None = None) -> KnownCameras:
    """The cameras stored beside photographs: COLMAP's model, ``transforms.json`` or ``poses_bounds.npy``.

    Args:
        sources: The photographs, read from files.
        where: The folder that holds the cameras; their own folders and the ones above unless it is given.

    Raises:
        ValueError: There are none, they are damaged, or they do not match the photographs.
    """
    stored: dict[Path, StoredCamera] = {}
    for folder in dict.fromkeys(source.path.parent for source in sources if source.path is not None):
        stored |= _stored(folder, where)
    if not stored:
        place = f"in {where}" if where is not None else "beside the photographs"
        raise ValueError(
            f"no cameras are stored {place}; expected a COLMAP model, transforms.json or poses_bounds.npy, or use "
            "poses=predicted"
        )
    places = tuple(place for place, source in enumerate(sources) if source.path in stored)
    if not places:
        raise ValueError("none of the photographs has a stored camera; use poses=predicted")
    views = [_camera(stored[path], sources[place]) for place in places if (path := sources[place].path) is not None]
    size = sources[0].view_size
    targets = [_camera(camera, covering(path.stem, camera.size, size)) for path, camera in stored.items()]
    return KnownCameras(_joined(views), places, _joined(targets), tuple(path.stem for path in stored))


def _stored(folder: Path, where: Path | None) -> dict[Path, StoredCamera]:
    images = sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file()),
        key=lambda path: natural(path.name),
    )
    for place in [where] if where is not None else [folder, folder.absolute().parent]:
        if found := read_poses(place, [path.name for path in images]):
            return {path: found[path.name] for path in images if path.name in found}
    return {}


def _camera(camera: StoredCamera, source: SourceImage) -> Cameras:
    (height, width), (stored_height, stored_width) = source.size, camera.size
    if abs(width * stored_height / (height * stored_width) - 1) > ASPECT:
        raise ValueError(
            f"the stored camera of {source.name} is for an image of {stored_width}x{stored_height} pixels, and the "
            f"photograph has {width}x{height}; give the poses of these photographs"
        )
    lens = source.view_intrinsics(torch.from_numpy(camera.for_size(*source.size)))
    pose = torch.from_numpy(camera.world_from_camera)
    return Cameras(pose.float()[None, None], lens.float()[None, None], source.view_size)


def _joined(cameras: Sequence[Cameras]) -> Cameras:
    return replace(
        cameras[0],
        world_from_camera=torch.cat([camera.world_from_camera for camera in cameras], dim=1),
        intrinsics=torch.cat([camera.intrinsics for camera in cameras], dim=1),
    )
