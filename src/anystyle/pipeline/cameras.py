"""Cameras that are known beforehand: read beside photographs, matched with the views, placed in their scene."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Adapter
from anystyle.data.folder import SourceImage, covering, image_files
from anystyle.data.poses import StoredCamera, read_poses, view_camera
from anystyle.errors import UserError
from anystyle.geometry.similarity import Similarity, similarity_of_cameras
from anystyle.pipeline.groups import Capture
from anystyle.types import Cameras

MAX_ASPECT_ERROR = 0.02
"""A stored camera's image may differ by this fraction from the photograph's aspect."""


@dataclass(frozen=True)
class KnownCameras:
    """Cameras in a frame and unit of their own.

    Args:
        views: Those of input views.
        indices: Which input view each of them belongs to.
        targets: Every stored camera, those of input views too.
        names: Of the targets.
    """

    views: Cameras
    indices: tuple[int, ...]
    targets: Cameras
    names: tuple[str, ...]

    def of_all(self, names: Sequence[str]) -> Cameras:
        """The cameras of all input views, in their order."""
        without = [name for index, name in enumerate(names) if index not in self.indices]
        if without:
            shown = ", ".join(without[:5])
            raise UserError(
                f"{len(without)} of {len(names)} photographs have no stored camera ({shown}); leave them out, or use "
                "poses=target"
            )
        return self.views

    def targets_in_scene(self, predicted: Cameras) -> tuple[Cameras, Similarity]:
        """The targets in the frame of predicted cameras, and the similarity from their own frame to it."""
        poses = predicted.world_from_camera[0, list(self.indices)]
        similarity = scene_from_known(self.views.world_from_camera[0].to(poses), poses)
        targets = self.targets.to(poses.device)
        return replace(targets, world_from_camera=similarity.poses(targets.world_from_camera)), similarity


def scene_from_known(known: Float[Tensor, "V 4 4"], predicted: Float[Tensor, "V 4 4"]) -> Similarity:
    """The similarity from the frame of known cameras to that of predicted ones, all of them world from camera."""
    similarity = similarity_of_cameras(known, predicted)
    if not bool(similarity.scale > 1e-9):
        raise UserError(
            "the known poses do not match the images: they move the other way from what the images show; check that "
            "they are in the images' order, or use poses=predicted"
        )
    return similarity


def with_cameras(capture: Capture, cameras: Cameras, adapter: Adapter) -> tuple[Capture, Similarity]:
    """The capture with its predicted cameras replaced by known ones, and the similarity from their frame to its own.

    Depth and Gaussians keep the unit that the network predicts in; the known cameras are brought there by the
    similarity that fits the predicted ones best.
    """
    groups, similarities = [], []
    for group in capture.groups:
        known = cameras.select(list(group.views))
        group_from_known = scene_from_known(known.world_from_camera[0], group.scene.cameras.world_from_camera[0])
        similarities.append(group_from_known)
        known = replace(known, world_from_camera=group_from_known.poses(known.world_from_camera))
        geometry = replace(group.scene.geometry, cameras=known)
        clusters = adapter.cluster(geometry, group.scene.attributes)
        capture_from_group = similarities[0].after(group_from_known.inverse()) if groups else None
        scene = replace(group.scene, geometry=geometry, clusters=clusters)
        groups.append(replace(group, scene=scene, capture_from_group=capture_from_group))
    return Capture(tuple(groups)), similarities[0]


def from_views(cameras: Cameras | None, names: Sequence[str]) -> KnownCameras:
    """The cameras that a source of scenes stores for its views."""
    if cameras is None:
        raise UserError("this source knows no cameras of its scenes; use poses=predicted")
    return KnownCameras(cameras, tuple(range(len(names))), cameras, tuple(names))


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
