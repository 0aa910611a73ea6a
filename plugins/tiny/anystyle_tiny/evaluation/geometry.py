"""How well a procedural scene is reconstructed, whose cameras and depth are known exactly."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.similarity import similarity_of_cameras
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Scene, Views


def pose_errors(
    predicted: Float[Tensor, "V 4 4"], true: Float[Tensor, "V 4 4"]
) -> tuple[Float[Tensor, " v"], Float[Tensor, " v"]]:
    """Angles in degrees by which the rotation and the direction of each view, seen from the first, are off.

    Args:
        predicted: World from camera.
        true: World from camera of the same views, in a frame and a unit of its own.
    """
    (rotation, direction), (true_rotation, true_direction) = relative(predicted), relative(true)
    cosine = ((rotation.mT @ true_rotation).diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return degrees(cosine), degrees((direction * true_direction).sum(-1))


def relative(world_from_camera: Float[Tensor, "V 4 4"]) -> tuple[Float[Tensor, "v 3 3"], Float[Tensor, "v 3"]]:
    """Rotation, and direction of the position, of each view after the first in the first view's axes."""
    first, others = world_from_camera[0], world_from_camera[1:]
    position = (others[:, :3, 3] - first[:3, 3]) @ first[:3, :3]
    return first[:3, :3].mT @ others[:, :3, :3], F.normalize(position, dim=-1)


def degrees(cosine: Float[Tensor, " v"]) -> Float[Tensor, " v"]:
    """The angle of a cosine."""
    return cosine.clamp(-1, 1).acos().rad2deg()


def mean_motion(
    rotations: Float[Tensor, "S v 3 3"], directions: Float[Tensor, "S v 3"]
) -> tuple[Float[Tensor, "v 3 3"], Float[Tensor, "v 3"]]:
    """The constant guess at each view's motion that fits many scenes best: chordal mean, and mean direction."""
    u, _, vh = torch.linalg.svd(rotations.mean(0))
    flip = torch.ones_like(u[:, 0])
    flip[:, 2] = torch.det(u @ vh)
    return u @ (flip[..., None] * vh), F.normalize(directions.mean(0), dim=-1)


def depth_error(predicted: Float[Tensor, "V H W"], true: Float[Tensor, "V H W"]) -> float:
    """Mean relative error of depth after one scale for all views, the median ratio; where depth is known."""
    known = true > 0
    scale = (true[known] / predicted[known].clamp_min(1e-6)).median()
    return float(((predicted[known] * scale - true[known]).abs() / true[known]).mean())


def psnr(drawn: Float[Tensor, "V 3 H W"], seen: Float[Tensor, "V 3 H W"]) -> list[float]:
    """Peak signal-to-noise ratio of each view in decibels."""
    return (-10 * (drawn - seen).square().mean((1, 2, 3)).clamp_min(1e-10).log10()).tolist()


def novel_cameras(scene: Scene, inputs: Views, novel: Views) -> Cameras:
    """True cameras of views that the model was not shown, in the frame that it predicted.

    The change of frame is the similarity that brings the true cameras of the input views closest to the predicted
    ones; the focal lengths change as those of the input views do on average.
    """
    assert inputs.cameras is not None and novel.cameras is not None
    frame = similarity_of_cameras(inputs.cameras.world_from_camera[0], scene.cameras.world_from_camera[0])
    intrinsics = novel.cameras.intrinsics.clone()
    for axis in (0, 1):
        predicted, true = scene.cameras.intrinsics[..., axis, axis], inputs.cameras.intrinsics[..., axis, axis]
        intrinsics[..., axis, axis] *= (predicted / true).log().mean().exp()
    pose = frame.poses(novel.cameras.world_from_camera[0])[None]
    return replace(novel.cameras, world_from_camera=pose, intrinsics=intrinsics)


def geometry_record(stylizer: Stylizer, scene: Scene, inputs: Views, novel: Views) -> dict[str, list[float]]:
    """What is known of one reconstructed scene, as plain numbers by name.

    Args:
        stylizer: Renders.
        scene: As encoded.
        inputs: The views it was encoded from, with true cameras and depth.
        novel: Further views.
    """
    assert inputs.cameras is not None and inputs.depth is not None
    rotation, direction = pose_errors(scene.cameras.world_from_camera[0], inputs.cameras.world_from_camera[0])
    gaussians = stylizer.unstyled(scene)
    drawn = stylizer.render(gaussians, scene.cameras).color[0]
    unseen = stylizer.render(gaussians, novel_cameras(scene, inputs, novel)).color[0]
    return {
        "rotation_deg": rotation.tolist(),
        "direction_deg": direction.tolist(),
        "depth_abs_rel": [depth_error(scene.geometry.depth[0], inputs.depth[0])],
        "psnr_input_views": psnr(drawn, inputs.images[0]),
        "psnr_novel_views": psnr(unseen, novel.images[0]),
    }


def baseline_record(inputs: Views, novel: Views) -> dict[str, list[float]]:
    """What knowing nothing gives: constant depth, and the input views' mean colour for every view.

    The true motions come along, for the constant guess at cameras takes those of all scenes.
    """
    assert inputs.cameras is not None and inputs.depth is not None
    rotations, directions = relative(inputs.cameras.world_from_camera[0])
    mean = inputs.images[0].mean((0, 2, 3))[:, None, None]
    return {
        "rotations": rotations.flatten().tolist(),
        "directions": directions.flatten().tolist(),
        "depth_abs_rel": [depth_error(torch.ones_like(inputs.depth[0]), inputs.depth[0])],
        "psnr_input_views": psnr(mean.expand_as(inputs.images[0]), inputs.images[0]),
        "psnr_novel_views": psnr(mean.expand_as(novel.images[0]), novel.images[0]),
    }
