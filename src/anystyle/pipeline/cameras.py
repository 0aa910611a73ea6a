"""Known cameras, and placing them in the frame of a scene."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Adapter
from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity, similarity_of_cameras
from anystyle.pipeline.groups import Capture
from anystyle.types import Cameras


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
