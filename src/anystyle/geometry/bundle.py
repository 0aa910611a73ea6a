"""Bundle adjustment: cameras, a scale of each view's depth, and the depth of points, from where points are seen."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.geometry.rotations import cross_matrix, matrix_from_vector

NEAREST = 0.05
"""Points nearer to a camera than this are not used, in the scene's units."""


class Tracks(NamedTuple):
    """Points of source views, and their observations in target views.

    Args:
        view: The source view of each point.
        ray: Image position of the point there: x and y at z = 1.
        log_depth: Logarithm of the source view's depth there.
        point: The point of each observation.
        target: The observing view.
        observed: Image position in that view: x and y at z = 1.
        target_log_depth: Logarithm of the target view's depth there.
        weight: Confidence of each observation, in [0, 1].
    """

    view: Int[Tensor, " T"]
    ray: Float[Tensor, "T 2"]
    log_depth: Float[Tensor, " T"]
    point: Int[Tensor, " O"]
    target: Int[Tensor, " O"]
    observed: Float[Tensor, "O 2"]
    target_log_depth: Float[Tensor, " O"]
    weight: Float[Tensor, " O"]


class Bundle(NamedTuple):
    """The unknowns of bundle adjustment.

    Args:
        rotation: Camera from world, of each view.
        translation: Camera from world, of each view.
        log_scale: Logarithm of the factor of each view's depth; 0 for the first view, which sets the unit.
        log_depth: Logarithm of each point's depth in its source view.
    """

    rotation: Float[Tensor, "V 3 3"]
    translation: Float[Tensor, "V 3"]
    log_scale: Float[Tensor, " V"]
    log_depth: Float[Tensor, " T"]


class _Residuals(NamedTuple):
    """Residuals with their derivatives.

    Args:
        error: The residuals.
        source: Derivatives by the motion of the source view: rotation vector, then translation.
        target: Derivatives by the motion of the target view.
        depth: Derivatives by the logarithm of the point's depth.
        weight: Of each residual.
    """

    error: Float[Tensor, "O K"]
    source: Float[Tensor, "O K 6"]
    target: Float[Tensor, "O K 6"]
    depth: Float[Tensor, "O K"]
    weight: Float[Tensor, "O K"]


def adjust(
    bundle: Bundle,
    tracks: Tracks,
    *,
    doubtful: tuple[float, ...],
    noise: float,
    depth_noise: float = 0.5,
    scale_noise: float = 0.3,
) -> Bundle:
    """Damped Gauss-Newton steps on reprojections and on the logarithm of depth; the first camera stays.

    Points are eliminated (Schur complement), so a step costs what the cameras cost. All errors are robust (Cauchy).

    Args:
        bundle: Where to begin.
        tracks: The observations.
        doubtful: For each step the scale of the Cauchy weights, an error at z = 1; from coarse to fine.
        noise: Standard deviation of observations at z = 1.
        depth_noise: Standard deviation of the logarithm of depth; far above that of single pixels, for errors are alike
            in all points of a surface.
        scale_noise: Standard deviation of the logarithm of the views' scales.
    """
    for cauchy_scale in doubtful:
        bundle = _step(bundle, tracks, cauchy_scale, noise, depth_noise, scale_noise)
    return bundle


def _step(
    bundle: Bundle, tracks: Tracks, doubtful: float, noise: float, depth_noise: float, scale_noise: float
) -> Bundle:
    num_views, num_points = len(bundle.rotation), len(tracks.view)
    reprojections, depths = _residuals(bundle, tracks, doubtful / noise, noise, depth_noise)
    source, size = tracks.view[tracks.point], 7 * num_views
    blocks: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
    for row, scaled in ((reprojections, False), (depths, True)):
        jacobian = row.error.new_zeros(*row.error.shape, size)
        for view, motion in ((source, row.source), (tracks.target, row.target)):
            column = (6 * view[:, None] + torch.arange(6, device=view.device))[:, None].expand_as(motion)
            jacobian.scatter_add_(2, column, motion)
        if scaled:
            jacobian.scatter_(2, (6 * num_views + tracks.target)[:, None, None], -1.0)
        blocks.append((row.error, jacobian, row.depth, row.weight))
    error, jacobian, depth, weight = (torch.cat(parts, dim=1) for parts in zip(*blocks, strict=True))
    weighted = jacobian * weight[..., None]
    cameras = torch.einsum("oka,okb->ab", weighted, jacobian)
    gradient = torch.einsum("oka,ok->a", weighted, error)
    mixed = error.new_zeros(num_points, size).index_add_(0, tracks.point, torch.einsum("oka,ok->oa", weighted, depth))
    points = error.new_zeros(num_points).index_add_(0, tracks.point, (weight * depth.square()).sum(1))
    point_gradient = error.new_zeros(num_points).index_add_(0, tracks.point, (weight * depth * error).sum(1))

    # The prior of each point's depth: the depth map of its source view.
    deviation = bundle.log_depth - bundle.log_scale[tracks.view] - tracks.log_depth
    prior = 1 / (1 + (deviation / depth_noise).square()) / depth_noise**2
    column = 6 * num_views + tracks.view
    points, point_gradient = points + prior, point_gradient + prior * deviation
    mixed.scatter_add_(1, column[:, None], -prior[:, None])
    cameras.diagonal().index_add_(0, column, prior)
    gradient.index_add_(0, column, -prior * deviation)
    scales = slice(6 * num_views, size)
    cameras.diagonal()[scales].add_(1 / scale_noise**2)
    gradient[scales] += bundle.log_scale / scale_noise**2

    # The Schur complement of the points, without the first camera and its scale.
    normal = cameras - (mixed / points[:, None]).mT @ mixed
    gradient = gradient - mixed.mT @ (point_gradient / points)
    free = torch.tensor([index for index in range(6, size) if index != 6 * num_views], device=error.device)
    normal = normal[free][:, free]
    normal = normal + torch.diag(1e-3 * normal.diagonal() + 1e-6)
    update = error.new_zeros(size)
    update[free] = -torch.linalg.solve(normal, gradient[free])
    motion = update[: 6 * num_views].unflatten(0, (num_views, 6)).clamp(-0.5, 0.5)
    rotation = matrix_from_vector(motion[:, :3])
    depth_update = -(point_gradient + mixed @ update) / points
    return Bundle(
        rotation=rotation @ bundle.rotation,
        translation=torch.einsum("vij,vj->vi", rotation, bundle.translation) + motion[:, 3:],
        log_scale=bundle.log_scale + update[scales],
        log_depth=bundle.log_depth + depth_update.clamp(-0.5, 0.5),
    )


def _residuals(
    bundle: Bundle, tracks: Tracks, doubtful: float, noise: float, depth_noise: float
) -> tuple[_Residuals, _Residuals]:
    """Reprojection errors, and differences of log depth to the target views' depth maps."""
    source, target = tracks.view[tracks.point], tracks.target
    ray = torch.cat([tracks.ray, torch.ones_like(tracks.ray[:, :1])], dim=-1)[tracks.point]
    in_source = ray * bundle.log_depth.exp()[tracks.point, None]  # O 3
    rotation = bundle.rotation[target] @ bundle.rotation[source].mT
    in_target = (
        torch.einsum("oij,oj->oi", rotation, in_source - bundle.translation[source]) + bundle.translation[target]
    )
    depth = in_target[:, 2].clamp_min(NEAREST)
    eye = torch.eye(3, dtype=in_source.dtype, device=in_source.device).expand(len(in_source), 3, 3)
    by_source = rotation @ torch.cat([cross_matrix(in_source), -eye], dim=-1)  # O 3 6
    by_target = torch.cat([-cross_matrix(in_target), eye], dim=-1)
    by_depth = torch.einsum("oij,oj->oi", rotation, in_source)
    slope = in_target[:, :2] / depth[:, None]
    project = torch.cat([eye[:, :2, :2], -slope[..., None]], dim=-1) / depth[:, None, None]  # O 2 3
    error = (slope - tracks.observed) / noise
    ahead = tracks.weight * (in_target[:, 2] > NEAREST)
    weight = ahead / (1 + (error.norm(dim=-1) / doubtful).square())
    reprojections = _Residuals(
        error=error,
        source=project @ by_source / noise,
        target=project @ by_target / noise,
        depth=torch.einsum("oij,oj->oi", project, by_depth) / noise,
        weight=weight[:, None].expand(-1, 2),
    )
    difference = (depth.log() - bundle.log_scale[target] - tracks.target_log_depth)[:, None]
    inverse = 1 / depth[:, None]
    # A third, for errors of depth are alike in all points of a surface.
    certainty = 0.3 * ahead[:, None] / (1 + (difference / depth_noise).square()) / depth_noise**2
    depths = _Residuals(
        error=difference,
        source=(by_source[:, 2] * inverse)[:, None],
        target=(by_target[:, 2] * inverse)[:, None],
        depth=by_depth[:, 2:] * inverse,
        weight=certainty,
    )
    return reprojections, depths
