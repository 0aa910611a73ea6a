"""Bundle adjustment: cameras, a scale of each view's depth, and the depth of points, from where points are seen."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

NEAREST = 0.05
"""Points nearer to a camera than this are not used, in the scene's units."""


class Tracks(NamedTuple):
    """Points of source views, and where target views see them.

    Args:
        view: The source view of each point.
        ray: Where it sees the point: x and y at z = 1.
        log_depth: What the source view's depth says of it.
        point: The point of each observation.
        target: The view that observes.
        place: Where: x and y at z = 1.
        target_log_depth: What the target view's depth says there.
        weight: How sure each observation is, in [0, 1].
    """

    view: Int[Tensor, " T"]
    ray: Float[Tensor, "T 2"]
    log_depth: Float[Tensor, " T"]
    point: Int[Tensor, " O"]
    target: Int[Tensor, " O"]
    place: Float[Tensor, "O 2"]
    target_log_depth: Float[Tensor, " O"]
    weight: Float[Tensor, " O"]


class Bundle(NamedTuple):
    """What is adjusted.

    Args:
        rotation: Camera from world, of each view.
        translation: Likewise.
        log_scale: Of each view's depth; the first view's stays 0, and sets the unit.
        log_depth: Of each point.
    """

    rotation: Float[Tensor, "V 3 3"]
    translation: Float[Tensor, "V 3"]
    log_scale: Float[Tensor, " V"]
    log_depth: Float[Tensor, " T"]


class _Row(NamedTuple):
    """Residuals with their derivatives.

    Args:
        error: What should be 0.
        source: By the motion of the source view.
        target: By that of the target view.
        depth: By the logarithm of the point's depth.
        weight: Of each.
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
        tracks: What is seen.
        doubtful: For each step the error at z = 1 from which on an observation counts as doubtful; from coarse to fine.
        noise: Standard deviation of observations at z = 1.
        depth_noise: Standard deviation of the logarithm of depth; far above that of single pixels, for errors are alike
            in all points of a surface.
        scale_noise: Standard deviation of the logarithm of the views' scales.
    """
    for bound in doubtful:
        bundle = _step(bundle, tracks, bound, noise, depth_noise, scale_noise)
    return bundle


def _step(
    bundle: Bundle, tracks: Tracks, doubtful: float, noise: float, depth_noise: float, scale_noise: float
) -> Bundle:
    views, points = len(bundle.rotation), len(tracks.view)
    seen, depths = _rows(bundle, tracks, doubtful / noise, noise, depth_noise)
    source, size = tracks.view[tracks.point], 7 * views
    blocks: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
    for row, scaled in ((seen, False), (depths, True)):
        jacobian = row.error.new_zeros(*row.error.shape, size)
        for view, motion in ((source, row.source), (tracks.target, row.target)):
            place = (6 * view[:, None] + torch.arange(6, device=view.device))[:, None].expand_as(motion)
            jacobian.scatter_add_(2, place, motion)
        if scaled:
            jacobian.scatter_(2, (6 * views + tracks.target)[:, None, None], -1.0)
        blocks.append((row.error, jacobian, row.depth, row.weight))
    error, jacobian, depth, weight = (torch.cat(parts, dim=1) for parts in zip(*blocks, strict=True))
    weighted = jacobian * weight[..., None]
    cameras = torch.einsum("oka,okb->ab", weighted, jacobian)
    pull = torch.einsum("oka,ok->a", weighted, error)
    mixed = error.new_zeros(points, size).index_add_(0, tracks.point, torch.einsum("oka,ok->oa", weighted, depth))
    own = error.new_zeros(points).index_add_(0, tracks.point, (weight * depth.square()).sum(1))
    own_pull = error.new_zeros(points).index_add_(0, tracks.point, (weight * depth * error).sum(1))

    # What the source view's own depth says of its points.
    off = bundle.log_depth - bundle.log_scale[tracks.view] - tracks.log_depth
    sure = 1 / (1 + (off / depth_noise).square()) / depth_noise**2
    place = 6 * views + tracks.view
    own, own_pull = own + sure, own_pull + sure * off
    mixed.scatter_add_(1, place[:, None], -sure[:, None])
    cameras.diagonal().index_add_(0, place, sure)
    pull.index_add_(0, place, -sure * off)
    scales = slice(6 * views, size)
    cameras.diagonal()[scales].add_(1 / scale_noise**2)
    pull[scales] += bundle.log_scale / scale_noise**2

    normal = cameras - (mixed / own[:, None]).mT @ mixed
    gradient = pull - mixed.mT @ (own_pull / own)
    free = torch.tensor([place for place in range(6, size) if place != 6 * views], device=error.device)
    normal = normal[free][:, free]
    normal = normal + torch.diag(1e-3 * normal.diagonal() + 1e-6)
    update = error.new_zeros(size)
    update[free] = -torch.linalg.solve(normal, gradient[free])
    motion = update[: 6 * views].unflatten(0, (views, 6)).clamp(-0.5, 0.5)
    turn = torch.linalg.matrix_exp(_cross_matrix(motion[:, :3]))
    deeper = -(own_pull + mixed @ update) / own
    return Bundle(
        rotation=turn @ bundle.rotation,
        translation=torch.einsum("vij,vj->vi", turn, bundle.translation) + motion[:, 3:],
        log_scale=bundle.log_scale + update[scales],
        log_depth=bundle.log_depth + deeper.clamp(-0.5, 0.5),
    )


def _rows(bundle: Bundle, tracks: Tracks, doubtful: float, noise: float, depth_noise: float) -> tuple[_Row, _Row]:
    """Errors of where points are seen, and of how far the target view's depth says they are."""
    source, target = tracks.view[tracks.point], tracks.target
    ray = torch.cat([tracks.ray, torch.ones_like(tracks.ray[:, :1])], dim=-1)[tracks.point]
    own = ray * bundle.log_depth.exp()[tracks.point, None]  # O 3, in the source view
    turn = bundle.rotation[target] @ bundle.rotation[source].mT
    moved = torch.einsum("oij,oj->oi", turn, own - bundle.translation[source]) + bundle.translation[target]
    depth = moved[:, 2].clamp_min(NEAREST)
    eye = torch.eye(3, dtype=own.dtype, device=own.device).expand(len(own), 3, 3)
    by_source = turn @ torch.cat([_cross_matrix(own), -eye], dim=-1)  # O 3 6
    by_target = torch.cat([-_cross_matrix(moved), eye], dim=-1)
    by_depth = torch.einsum("oij,oj->oi", turn, own)
    slope = moved[:, :2] / depth[:, None]
    project = torch.cat([eye[:, :2, :2], -slope[..., None]], dim=-1) / depth[:, None, None]  # O 2 3
    error = (slope - tracks.place) / noise
    ahead = tracks.weight * (moved[:, 2] > NEAREST)
    weight = ahead / (1 + (error.norm(dim=-1) / doubtful).square())
    seen = _Row(
        error=error,
        source=project @ by_source / noise,
        target=project @ by_target / noise,
        depth=torch.einsum("oij,oj->oi", project, by_depth) / noise,
        weight=weight[:, None].expand(-1, 2),
    )
    far = (depth.log() - bundle.log_scale[target] - tracks.target_log_depth)[:, None]
    inverse = 1 / depth[:, None]
    # A third, for errors of depth are alike in all points of a surface.
    sure = 0.3 * ahead[:, None] / (1 + (far / depth_noise).square()) / depth_noise**2
    depths = _Row(
        error=far,
        source=(by_source[:, 2] * inverse)[:, None],
        target=(by_target[:, 2] * inverse)[:, None],
        depth=by_depth[:, 2:] * inverse,
        weight=sure,
    )
    return seen, depths


def _cross_matrix(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
