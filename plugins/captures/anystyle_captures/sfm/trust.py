"""Which of several models to take, which of its views, and how far it can be trusted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from anystyle.contracts import Verdict
from anystyle.errors import listing
from anystyle.geometry.transforms import similarity_of_cameras
from anystyle.paths import natural
from anystyle_captures.sfm.model import MIN_VIEWS, SparseModel, VerifiedPair, ViewGraph

Array = np.ndarray
MIN_SUPPORT = 30
"""Points seen by two other views that a view needs to keep its position."""
MAX_ROTATION, MAX_POSITION = 2.0, 0.1
"""How far the mappers may differ on a view: in degrees, and relative to the spread of the cameras."""
MIN_PARALLAX = 1.5
"""Median triangulation angle in degrees below which depth is unreliable."""
MIN_POINTS = 100
"""Points of a model below which its lens, and so its shape, is uncertain."""
MIN_FEATURES = 60
"""Median features of a photograph below which it shows too little texture."""
MAX_ROTATION_SHARE = 0.7
"""Fraction of matches explained by rotations from which a camera turned without moving."""


def judge(graph: ViewGraph, candidates: Sequence[Sequence[SparseModel]]) -> tuple[SparseModel, Verdict]:
    """Choose the model with most views that enough points support, then with most points.

    Views on which the best model of another mapper disagrees are left out if others remain.
    """
    rotation_share = share_of_rotation(graph.pairs, graph.sizes) if graph.pairs else 0.0
    failed = Verdict("failed", (_why_failed(graph, rotation_share),), {"registered": 0.0, "turned": rotation_share})
    plausible = (
        [each.restricted(np.flatnonzero(each.reaches_border).tolist()) for each in models] for models in candidates
    )
    supported = ([each.restricted(supported_views(each.seen, MIN_SUPPORT)) for each in models] for models in plausible)
    enough = ([model for model in models if model.registered.sum() >= MIN_VIEWS] for models in supported)
    best = sorted((max(models, key=_rank) for models in enough if models), key=_rank, reverse=True)
    if not best:
        return SparseModel.empty(len(graph.names)), failed
    doubts, views, measures = _compare(graph, best)
    model = best[0].restricted(views)
    parallax = float(np.median(model.triangulation_angles()))
    if parallax < MIN_PARALLAX:
        doubts.append(
            f"the rays to a point differ by {parallax:.1f}° in the median, so depth is uncertain; "
            "move further sideways between photographs"
        )
    if len(model.points) < MIN_POINTS:
        doubts.append(f"only {len(model.points)} points hold these cameras; take more photographs, with smaller steps")
    if doubts and rotation_share >= MAX_ROTATION_SHARE:
        return SparseModel.empty(len(graph.names)), failed
    measures |= {"registered": float(len(views)), "points": float(len(model.points))}
    measures |= {"parallax_degrees": parallax, "turned": rotation_share}
    measures |= {"searched_pixels": float(max(map(max, graph.sizes)))}
    return model, Verdict("doubtful" if doubts else "good", (*doubts, *_left_out(graph, best[0])), measures)


def _rank(model: SparseModel) -> tuple[int, int]:
    return int(model.registered.sum()), len(model.points)


def _compare(graph: ViewGraph, best: Sequence[SparseModel]) -> tuple[list[str], list[int], dict[str, float]]:
    """What speaks against the first model, which of its views remain, and what was measured."""
    views = np.flatnonzero(best[0].registered)
    common = np.flatnonzero(best[0].registered & best[1].registered) if len(best) > 1 else views[:0]
    if len(common) < MIN_VIEWS:
        return ["only one of two methods found these cameras, and nothing confirms them"], views.tolist(), {}
    difference = agreement(best[1].world_from_camera[common], best[0].world_from_camera[common])
    rotation, position = difference.rotation.max(), difference.position.max()
    measures = {"mappers_rotation_degrees": float(rotation), "mappers_position": float(position)}
    agreed = (difference.rotation <= MAX_ROTATION) & (difference.position <= MAX_POSITION)
    if agreed.all():
        return [], views.tolist(), measures
    wrong = common[~agreed]
    doubt = (
        f"two methods disagree on the cameras of {_names(graph, wrong.tolist())} (by up to {rotation:.1f}° and "
        f"{100 * position:.0f} % of the path's size); take photographs between these and their neighbours"
    )
    # Where most views disagree, nothing tells which of them are right.
    remaining = np.setdiff1d(views, wrong) if agreed.sum() >= max(MIN_VIEWS, len(agreed) / 2) else views
    return [doubt], remaining.tolist(), measures


def _why_failed(graph: ViewGraph, rotation_share: float) -> str:
    """Why photographs gave no cameras, and what to do."""
    count, features = len(graph.names), float(np.median(graph.num_features))
    if count == 1:
        return "one photograph shows no depth; take at least three, with a step sideways between them"
    if features < MIN_FEATURES:
        return (
            f"there is too little to see in the photographs ({features:.0f} points each in the median): "
            "a blank surface, darkness or blur; show textured things, in focus"
        )
    group = _largest_group(count, graph.pairs)
    if len(group) < min(count, MIN_VIEWS):
        which = "no two of them show" if len(group) == 1 else f"only {_names(graph, group)} show"
        return (
            f"the photographs do not overlap: {which} the same things; "
            "neighbouring photographs should share at least two thirds of what they show"
        )
    if count < MIN_VIEWS:
        return f"{count} photographs overlap, and at least {MIN_VIEWS} are needed to find where cameras were"
    if rotation_share >= MAX_ROTATION_SHARE:
        return "the camera turned without moving, which shows no depth; take a step sideways between photographs"
    return "the photographs share too little for a model of three of them; take more, with smaller steps between"


def _largest_group(count: int, pairs: Sequence[VerifiedPair]) -> list[int]:
    """The largest set of photographs connected by pairs with matches."""
    graph = np.zeros((count, count))
    graph[[pair.first for pair in pairs], [pair.second for pair in pairs]] = 1
    group = connected_components(graph, directed=False)[1]
    return np.flatnonzero(group == np.bincount(group).argmax()).tolist()


def _left_out(graph: ViewGraph, model: SparseModel) -> list[str]:
    """Sentences about photographs without a camera."""
    matched = {view for pair in graph.pairs for view in (pair.first, pair.second)}
    missing = np.flatnonzero(~model.registered).tolist()
    alone, weak = ([view for view in missing if (view in matched) is known] for known in (False, True))
    reasons = []
    if alone:
        reasons.append(f"left out, as nothing is shared with any other photograph: {_names(graph, alone)}")
    if weak:
        reasons.append(
            f"left out, as too little is shared with the others: {_names(graph, weak)}; "
            "take photographs between these and their neighbours"
        )
    return reasons


def _names(graph: ViewGraph, views: Sequence[int]) -> str:
    return listing(sorted((graph.names[view] for view in views), key=natural), 6)


def supported_views(seen: Bool[Array, "P V"], least: int) -> list[int]:
    """The largest set of views that grows from a pair by views of at least ``least`` points that two of the set see.

    A point that only two views see fixes the direction between them, not the distance.
    """
    counts = seen.astype(np.int64)
    shared = np.triu(counts.T @ counts, k=1)
    best: list[int] = []
    # The set is grown from each of the eight pairs that share most points.
    for pair in np.argsort(-shared, axis=None, kind="stable")[:8]:
        first, second = (int(view) for view in np.unravel_index(pair, shared.shape))
        views = [first, second] if shared[first, second] >= least else []
        while views:
            support = seen[seen[:, views].sum(1) >= 2].sum(0)
            support[views] = 0
            if support.max() < least:
                break
            views.append(int(support.argmax()))
        best = max(best, views, key=len)
    return sorted(best)


class Agreement(NamedTuple):
    """Differences of views that two models have in common, after a similarity that fits most of them."""

    rotation: Float64[Array, " V"]
    position: Float64[Array, " V"]


def agreement(first: Float64[Array, "V 4 4"], second: Float64[Array, "V 4 4"]) -> Agreement:
    """Compare the poses that two models give to the same views, at least 2, up to half of which may be anywhere.

    The similarity is fitted to all views and then repeatedly to the better half of them (at least 3).
    """
    poses, target = torch.from_numpy(first), torch.from_numpy(second)
    spread = max(float((target[:, :3, 3] - target[:, :3, 3].mean(0)).square().sum(1).mean().sqrt()), 1e-12)
    chosen = np.arange(len(first))
    rotation = position = np.empty(0)
    for _ in range(8):
        moved = similarity_of_cameras(poses[chosen], target[chosen]).poses(poses)
        turn = moved[:, :3, :3].mT @ target[:, :3, :3]
        rotation = np.rad2deg(Rotation.from_matrix(turn.numpy()).magnitude())
        position = (moved[:, :3, 3] - target[:, :3, 3]).norm(dim=1).numpy() / spread
        order = np.argsort(position + rotation / 30, kind="stable")
        closest = np.sort(order[: max(3, (len(first) + 1) // 2)])
        if np.array_equal(closest, chosen):
            break
        chosen = closest
    return Agreement(rotation, position)


def share_of_rotation(pairs: Sequence[VerifiedPair], sizes: Sequence[tuple[int, int]]) -> float:
    """The fraction of matches that rotations of the camera explain, in the quarter of pairs where it is smallest.

    It is near 1 for a camera that turned without moving, and small for a flat scene.
    """
    sampled = [pairs[index] for index in np.unique(np.linspace(0, len(pairs) - 1, 60).round().astype(int))]
    # The focal length, in longer sides, is unknown: it decides how far a rotation moves points.
    shares = [sorted(_explained(pair, sizes, focal) for pair in sampled) for focal in np.geomspace(0.5, 3.0, 10)]
    return float(np.array(shares)[:, : max(1, len(sampled) // 4)].mean(1).max())


def _explained(pair: VerifiedPair, sizes: Sequence[tuple[int, int]], focal: float) -> float:
    """The fraction of a pair's matches that the best rotation explains; ``focal`` is in longer sides."""
    sampled = np.unique(np.linspace(0, pair.pixels.shape[1] - 1, 200).round().astype(int))
    first, second = (
        _rays(pixels, sizes[view], focal)
        for pixels, view in zip(pair.pixels[:, sampled], (pair.first, pair.second), strict=True)
    )
    bound = 0.004 / focal  # 2 pixels of 512
    weight, error = np.ones(len(sampled)), np.zeros(len(sampled))
    for _ in range(5):
        rotation = Rotation.align_vectors(second, first, weights=weight)[0]
        error = np.linalg.norm(second - rotation.apply(first), axis=1)
        weight = 1 / (1 + np.square(error / bound))
    return float((error <= bound).mean())


def _rays(pixels: Float[Array, "M 2"], size: tuple[int, int], focal: float) -> Float[Array, "M 3"]:
    height, width = size
    centered = (pixels - np.array([width / 2, height / 2])) / (focal * max(size))
    rays = np.concatenate([centered, np.ones((len(pixels), 1))], axis=1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
