"""Rigid motions between views from matched points, in closed form and by Gauss-Newton steps."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Rigid(NamedTuple):
    """Rigid motions ``x -> rotation x + translation``."""

    rotation: Float[Tensor, "M 3 3"]
    translation: Float[Tensor, "M 3"]


class MatchedPoints(NamedTuple):
    """What two views know of the same points, each in its own camera's frame.

    Args:
        source: Points as the source view sees them.
        target: The same points as the target view sees them.
        source_ray: Where the source view sees them: x and y at z = 1.
        target_ray: Likewise in the target view.
        weight: How sure each match is, at least 0.
    """

    source: Float[Tensor, "M P 3"]
    target: Float[Tensor, "M P 3"]
    source_ray: Float[Tensor, "M P 2"]
    target_ray: Float[Tensor, "M P 2"]
    weight: Float[Tensor, "M P"]


def kabsch(source: Float[Tensor, "M P 3"], target: Float[Tensor, "M P 3"], weight: Float[Tensor, "M P"]) -> Rigid:
    """The rigid motion from ``source`` to ``target`` with the least weighted squared error (Kabsch 1976)."""
    share = weight[..., None] / weight.sum(-1, keepdim=True).clamp_min(1e-12)[..., None]
    source_mean, target_mean = (share * source).sum(1), (share * target).sum(1)
    covariance = ((target - target_mean[:, None]) * share).mT @ (source - source_mean[:, None])
    u, _, vh = torch.linalg.svd(covariance)
    flip = torch.ones_like(source_mean)
    flip[:, 2] = torch.det(u @ vh)
    rotation = u @ (flip[..., None] * vh)
    return Rigid(rotation, target_mean - torch.einsum("mij,mj->mi", rotation, source_mean))


def align(matches: MatchedPoints, *, scale: float, rounds: int = 3, steps: int = 5) -> Rigid:
    """The motion from source to target that explains the matches best, robustly.

    Kabsch rounds on the points, reweighted by their errors (Cauchy), come first; then Gauss-Newton steps on where each
    view sees the other's points, which trusts directions more than depths. The Kabsch rounds carry no gradient; the
    steps do, so what made the matches can learn from the motion.

    Args:
        matches: At least three points each; a pair without weight stays where it is.
        scale: Error at z = 1 from which on a match counts as doubtful.
        rounds: Kabsch rounds.
        steps: Gauss-Newton steps.
    """
    with torch.no_grad():
        motion = _robust_kabsch(matches, rounds)
    for _ in range(steps):
        motion = _step(motion, matches, scale)
    return motion


def _robust_kabsch(matches: MatchedPoints, rounds: int) -> Rigid:
    weight = matches.weight
    motion = kabsch(matches.source, matches.target, weight)
    for _ in range(rounds - 1):
        moved = matches.source @ motion.rotation.mT + motion.translation[:, None]
        # Depth errors grow with depth.
        error = (moved - matches.target).norm(dim=-1) / matches.target.norm(dim=-1).clamp_min(1e-6)
        spread = error.median(-1, keepdim=True).values.clamp_min(1e-4)
        motion = kabsch(matches.source, matches.target, weight / (1 + (error / spread).square()))
    return motion


def _step(motion: Rigid, matches: MatchedPoints, scale: float) -> Rigid:
    """One damped Gauss-Newton step on the left of the motion, on reprojections in both views."""
    moved = matches.source @ motion.rotation.mT + motion.translation[:, None]
    back = (matches.target - motion.translation[:, None]) @ motion.rotation
    # For x' = exp(w) x + v:  dx' = v - x cross w; in the source view dx = -R^T (v - target cross w).
    forward = _project_jacobian(moved) @ _motion_jacobian(moved)
    backward = -_project_jacobian(back) @ (motion.rotation.mT[:, None] @ _motion_jacobian(matches.target))
    residual = torch.cat([_project(moved) - matches.target_ray, _project(back) - matches.source_ray], dim=1)
    jacobian = torch.cat([forward, backward], dim=1)  # M 2P 2 6
    ahead = torch.cat([moved[..., 2] > 0.05, back[..., 2] > 0.05], dim=1)
    error = residual.detach().norm(dim=-1) / scale
    weight = torch.cat([matches.weight, matches.weight], dim=1) * ahead / (1 + error.square())
    weighted = jacobian * weight[..., None, None]
    normal = torch.einsum("mpri,mprj->mij", weighted, jacobian)
    gradient = torch.einsum("mpri,mpr->mi", weighted, residual)
    damping = 1e-4 * torch.diagonal(normal, dim1=-2, dim2=-1).mean(-1) + 1e-8
    eye = torch.eye(6, dtype=normal.dtype, device=normal.device)
    update = -torch.linalg.solve(normal + damping[:, None, None] * eye, gradient)
    turn = torch.linalg.matrix_exp(_cross_matrix(update[:, :3]))
    return Rigid(turn @ motion.rotation, torch.einsum("mij,mj->mi", turn, motion.translation) + update[:, 3:])


def _project(points: Float[Tensor, "M P 3"]) -> Float[Tensor, "M P 2"]:
    return points[..., :2] / points[..., 2:].clamp_min(0.05)


def _project_jacobian(points: Float[Tensor, "M P 3"]) -> Float[Tensor, "M P 2 3"]:
    inverse = 1 / points[..., 2].clamp_min(0.05)
    zero = torch.zeros_like(inverse)
    rows = [
        torch.stack([inverse, zero, -points[..., 0] * inverse.square()], dim=-1),
        torch.stack([zero, inverse, -points[..., 1] * inverse.square()], dim=-1),
    ]
    return torch.stack(rows, dim=-2)


def _motion_jacobian(points: Float[Tensor, "M P 3"]) -> Float[Tensor, "M P 3 6"]:
    eye = torch.eye(3, dtype=points.dtype, device=points.device).expand(*points.shape[:2], 3, 3)
    return torch.cat([-_cross_matrix(points), eye], dim=-1)


def _cross_matrix(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


class Similarity(NamedTuple):
    """A change of frame ``x -> scale rotation x + translation``."""

    scale: Float[Tensor, ""]
    rotation: Float[Tensor, "3 3"]
    translation: Float[Tensor, "3"]

    def moved(self, world_from_camera: Float[Tensor, "V 4 4"]) -> Float[Tensor, "V 4 4"]:
        """Cameras of the old frame in the new one."""
        pose = world_from_camera.clone()
        pose[:, :3, :3] = self.rotation @ world_from_camera[:, :3, :3]
        pose[:, :3, 3] = self.scale * world_from_camera[:, :3, 3] @ self.rotation.mT + self.translation
        return pose


def similarity_of_cameras(source: Float[Tensor, "V 4 4"], target: Float[Tensor, "V 4 4"]) -> Similarity:
    """The change of frame that brings cameras closest to others of the same views.

    The rotation is the chordal mean of what each view says, since the places of a few cameras on a line leave it open;
    scale and translation then have the least squared error of the places. Cameras at one place keep their scale.

    Args:
        source: World from camera in the old frame; at least one view.
        target: World from camera in the new frame.
    """
    u, _, vh = torch.linalg.svd((target[:, :3, :3] @ source[:, :3, :3].mT).mean(0))
    flip = torch.ones_like(u[0])
    flip[2] = torch.det(u @ vh)
    rotation = u @ (flip[:, None] * vh)
    turned, places = source[:, :3, 3] @ rotation.mT, target[:, :3, 3]
    spread, wanted = turned - turned.mean(0), places - places.mean(0)
    size = spread.square().sum()
    scale = torch.where(size > 1e-12, (spread * wanted).sum().clamp_min(0) / size.clamp_min(1e-12), 1.0)
    return Similarity(scale, rotation, places.mean(0) - scale * turned.mean(0))
