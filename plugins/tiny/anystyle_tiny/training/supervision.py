"""Losses of geometry: of depth, of cameras, and of both through the world points of pixels."""

from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.types import Cameras, Geometry, Views


def canonical(views: Views, context: int) -> Views:
    """Views with the first camera at the origin, and the points of the ``context`` first views at mean distance 1."""
    if views.cameras is None or views.depth is None:
        raise UserError("reconstruction learns from scenes with cameras and depth; choose another scenes=")
    first = views.cameras.camera_from_world[:, :1]
    cameras = replace(views.cameras, world_from_camera=first @ views.cameras.world_from_camera)
    points = Geometry(cameras, views.depth, torch.ones_like(views.depth)).points()[:, :context]
    valid = (views.depth[:, :context] > 0).to(points.dtype)
    distance = (points.norm(dim=-1) * valid).sum((1, 2, 3)) / valid.sum((1, 2, 3)).clamp_min(1)
    scale = 1 / distance.clamp_min(1e-6)[:, None]
    poses = cameras.world_from_camera.clone()
    poses[..., :3, 3] *= scale[..., None]
    return replace(views, cameras=replace(cameras, world_from_camera=poses), depth=views.depth * scale[..., None, None])


def depth_loss(
    predicted: Float[Tensor, "B V H W"],
    confidence: Float[Tensor, "B V H W"],
    true: Float[Tensor, "B V H W"],
    *,
    alpha: float = 0.2,
    gradient: float = 1.0,
) -> Float[Tensor, ""]:
    """Confidence-weighted error of log depth and of its differences 1, 2 and 4 pixels apart (after VGGT Eq. 3).

    True depth is 0 where it is missing; ``alpha`` rewards ``log confidence``; ``gradient`` weighs the differences.
    """
    valid = true > 0
    error = predicted.clamp_min(1e-4).log() - true.clamp_min(1e-4).log()
    confidence = confidence.clamp_min(1e-3)
    loss = masked_mean(confidence * error.abs() - alpha * confidence.log(), valid)
    for step in (1, 2, 4):
        for axis in (-1, -2):
            count = max(0, error.shape[axis] - step)
            slope = error.narrow(axis, -count, count) - error.narrow(axis, 0, count)
            both = valid.narrow(axis, -count, count) & valid.narrow(axis, 0, count)
            loss = loss + gradient / 6 * masked_mean(slope.abs(), both)
    return loss


def camera_loss(predicted: Cameras, true: Cameras) -> Float[Tensor, ""]:
    """Error of rotations (chordal), of positions and translations, and of log focal lengths."""
    rotation = predicted.world_from_camera[..., :3, :3] - true.world_from_camera[..., :3, :3]
    chordal = huber(rotation.flatten(-2).square().sum(-1).add(1e-8).sqrt())
    position = huber((predicted.world_from_camera - true.world_from_camera)[..., :3, 3])
    translation = huber((predicted.camera_from_world - true.camera_from_world)[..., :3, 3])
    focal = torch.stack(
        [(predicted.intrinsics[..., i, i] / true.intrinsics[..., i, i]).clamp_min(1e-3).log() for i in (0, 1)]
    )
    return chordal + position + translation + focal.abs().mean()


def transfer_loss(
    predicted: Cameras, true: Cameras, depth: Float[Tensor, "B V H W"], *, stride: int = 4
) -> Float[Tensor, ""]:
    """Distance of each view's points between the predicted and the true camera frame, relative to their depth.

    Unlike errors of rotation and translation it weighs both by their effect on the image.
    """
    world, depth = _strided(Geometry(true, depth, depth).points(), stride), _strided(depth, stride)
    local = _into(predicted.camera_from_world, world) - _into(true.camera_from_world, world)
    return masked_mean(_smooth_l1(local.norm(dim=-1) / depth.clamp_min(0.05)), depth > 0)


def point_loss(geometry: Geometry, true: Cameras, depth: Float[Tensor, "B V H W"], *, stride: int = 2) -> Tensor:
    """Distance of predicted world points from the true ones, relative to their distance from the first camera."""
    world, predicted = (_strided(one.points(), stride) for one in (Geometry(true, depth, depth), geometry))
    error = (predicted - world).norm(dim=-1) / world.norm(dim=-1).clamp_min(0.1)
    return masked_mean(_smooth_l1(error), _strided(depth, stride) > 0)


def project(cameras: Cameras, world: Float[Tensor, "B M 3"]) -> tuple[Float[Tensor, "B V M 2"], Float[Tensor, "B V M"]]:
    """Projections of world points into every camera: pixels, and depth along z, at most 0 behind the camera."""
    local = _into(cameras.camera_from_world, world[:, None].expand(-1, cameras.intrinsics.shape[1], -1, -1))
    depth = local[..., 2]
    pixel = local @ cameras.intrinsics.mT
    return pixel[..., :2] / depth.clamp_min(1e-4)[..., None], depth


def huber(error: Float[Tensor, "..."], *, width: float = 0.1) -> Float[Tensor, ""]:
    """The mean of ``|error|``, quadratic below ``width``."""
    return _smooth_l1(error, width).mean()


def _smooth_l1(error: Tensor, width: float = 0.05) -> Tensor:
    return F.smooth_l1_loss(error, torch.zeros_like(error), beta=width, reduction="none")


def masked_mean(values: Tensor, valid: Bool[Tensor, "..."]) -> Tensor:
    """The mean of the values that are ``valid``; 0 if none is."""
    return (values * valid).sum() / valid.sum().clamp_min(1)


def _into(frame: Float[Tensor, "B V 4 4"], points: Tensor) -> Tensor:
    local = points.flatten(2, -2) @ frame[..., :3, :3].mT + frame[..., None, :3, 3]
    return local.reshape(points.shape)


def _strided(values: Float[Tensor, "B V H W *C"], stride: int) -> Float[Tensor, "B V h w *C"]:
    """Every ``stride``-th pixel, from the middle of the first ``stride`` pixels on."""
    return values[:, :, stride // 2 :: stride, stride // 2 :: stride]
