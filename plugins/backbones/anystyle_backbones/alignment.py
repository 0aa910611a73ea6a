"""Rigid motions from matched points, or from points and the rays they lie on: closed forms and Gauss-Newton steps."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.transforms import cross_matrix, matrix_from_vector, nearest_rotation


class Rigid(NamedTuple):
    """Rigid motions ``x -> rotation x + translation``."""

    rotation: Float[Tensor, "M 3 3"]
    translation: Float[Tensor, "M 3"]


class MatchedPoints(NamedTuple):
    """The same points in two cameras' frames, their image positions at z = 1, and the confidence of each match."""

    source: Float[Tensor, "M P 3"]
    target: Float[Tensor, "M P 3"]
    source_ray: Float[Tensor, "M P 2"]
    target_ray: Float[Tensor, "M P 2"]
    weight: Float[Tensor, "M P"]


def kabsch(source: Float[Tensor, "M P 3"], target: Float[Tensor, "M P 3"], weight: Float[Tensor, "M P"]) -> Rigid:
    """The rigid motion from ``source`` to ``target`` with the least weighted squared error (Kabsch 1976)."""
    normalized = weight[..., None] / weight.sum(-1, keepdim=True).clamp_min(1e-12)[..., None]
    source_mean, target_mean = (normalized * source).sum(1), (normalized * target).sum(1)
    covariance = ((target - target_mean[:, None]) * normalized).mT @ (source - source_mean[:, None])
    rotation = nearest_rotation(covariance)
    return Rigid(rotation, target_mean - torch.einsum("mij,mj->mi", rotation, source_mean))


def align(matches: MatchedPoints, *, scale: float, rounds: int = 3, steps: int = 5) -> Rigid:
    """The motion from source to target that explains the matches best, robustly.

    Kabsch rounds on the points, reweighted by their errors (Cauchy), come first; then Gauss-Newton steps on the
    reprojection errors in both views, which weigh directions more than depths. Only the steps carry a gradient.

    Args:
        matches: At least three points each; a pair without weight stays where it is.
        scale: Scale of the Cauchy weights: an error at z = 1.
        rounds: Kabsch rounds.
        steps: Gauss-Newton steps.
    """
    with torch.no_grad():
        motion = _robust_kabsch(matches, rounds)
    for _ in range(steps):
        motion = _step(motion, matches, scale)
    return motion


@torch.no_grad()
def resect(
    points: Float[Tensor, "M P 3"], rays: Float[Tensor, "M P 2"], *, scale: float, rounds: int = 20, steps: int = 10
) -> Rigid:
    """The motion from the points' frame to that of a camera which sees them at image positions ``rays``, robustly.

    Orthogonal iteration (Lu, Hager and Mjolsness 2000) starts with the points as far from the camera as they are from
    their own origin; Gauss-Newton steps on reprojection errors follow. Errors are weighted as by :func:`align`.

    Args:
        points: In any frame, ahead of the camera but for outliers.
        rays: At z = 1.
        scale: Scale of the Cauchy weights: an error at z = 1.
        rounds: Rounds of the iteration.
        steps: Gauss-Newton steps.
    """
    directions = F.normalize(F.pad(rays, (0, 1), value=1.0), dim=-1)
    distance, weight = points.norm(dim=-1, keepdim=True), torch.ones_like(points[..., 0])
    motion = kabsch(points, directions * distance, weight)
    for step in range(rounds + steps):
        local = points @ motion.rotation.mT + motion.translation[:, None]
        residual = _project(local) - rays
        weight = (local[..., 2] > 0.05) / (1 + (residual.norm(dim=-1) / scale).square())
        if step < rounds:
            distance = (local * directions).sum(-1, keepdim=True).clamp_min(0.05)
            motion = kabsch(points, directions * distance, weight)
        else:
            motion = _moved(motion, _project_jacobian(local) @ _motion_jacobian(local), residual, weight)
    return motion


def _robust_kabsch(matches: MatchedPoints, rounds: int) -> Rigid:
    weight = matches.weight
    motion = kabsch(matches.source, matches.target, weight)
    for _ in range(rounds - 1):
        predicted = matches.source @ motion.rotation.mT + motion.translation[:, None]
        # Depth errors grow with depth.
        error = (predicted - matches.target).norm(dim=-1) / matches.target.norm(dim=-1).clamp_min(1e-6)
        # The lower median, as torch.median's, which has no deterministic kernel for CUDA.
        spread = error.sort(-1).values[..., (error.shape[-1] - 1) // 2, None].clamp_min(1e-4)
        motion = kabsch(matches.source, matches.target, weight / (1 + (error / spread).square()))
    return motion


def _step(motion: Rigid, matches: MatchedPoints, scale: float) -> Rigid:
    """One damped Gauss-Newton step on the left of the motion, on reprojections in both views."""
    in_target = matches.source @ motion.rotation.mT + motion.translation[:, None]
    in_source = (matches.target - motion.translation[:, None]) @ motion.rotation
    # For x' = exp(w) x + v:  dx' = v - x cross w; in the source view dx = -R^T (v - target cross w).
    forward = _project_jacobian(in_target) @ _motion_jacobian(in_target)
    backward = -_project_jacobian(in_source) @ (motion.rotation.mT[:, None] @ _motion_jacobian(matches.target))
    residual = torch.cat([_project(in_target) - matches.target_ray, _project(in_source) - matches.source_ray], dim=1)
    jacobian = torch.cat([forward, backward], dim=1)  # M 2P 2 6
    ahead = torch.cat([in_target[..., 2] > 0.05, in_source[..., 2] > 0.05], dim=1)
    error = residual.detach().norm(dim=-1) / scale
    weight = torch.cat([matches.weight, matches.weight], dim=1) * ahead / (1 + error.square())
    return _moved(motion, jacobian, residual, weight)


def _moved(
    motion: Rigid, jacobian: Float[Tensor, "M P 2 6"], residual: Float[Tensor, "M P 2"], weight: Float[Tensor, "M P"]
) -> Rigid:
    """The motion after a damped Gauss-Newton step on its left."""
    weighted = jacobian * weight[..., None, None]
    normal = torch.einsum("mpri,mprj->mij", weighted, jacobian)
    gradient = torch.einsum("mpri,mpr->mi", weighted, residual)
    damping = 1e-4 * torch.diagonal(normal, dim1=-2, dim2=-1).mean(-1) + 1e-8
    eye = torch.eye(6, dtype=normal.dtype, device=normal.device)
    update = -torch.linalg.solve(normal + damping[:, None, None] * eye, gradient)
    rotation = matrix_from_vector(update[:, :3])
    return Rigid(rotation @ motion.rotation, torch.einsum("mij,mj->mi", rotation, motion.translation) + update[:, 3:])


def _project(points: Float[Tensor, "M P 3"]) -> Float[Tensor, "M P 2"]:
    return points[..., :2] / points[..., 2:].clamp_min(0.05)


def _project_jacobian(points: Float[Tensor, "M P 3"]) -> Float[Tensor, "M P 2 3"]:
    inverse = 1 / points[..., 2:].clamp_min(0.05)  # M P 1
    slopes = -points[..., :2] * inverse.square()
    return torch.cat([torch.diag_embed(inverse.expand_as(slopes)), slopes[..., None]], dim=-1)


def _motion_jacobian(points: Float[Tensor, "M P 3"]) -> Float[Tensor, "M P 3 6"]:
    eye = torch.eye(3, dtype=points.dtype, device=points.device).expand(*points.shape[:2], 3, 3)
    return torch.cat([-cross_matrix(points), eye], dim=-1)
