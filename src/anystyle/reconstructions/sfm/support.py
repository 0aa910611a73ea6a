"""What speaks for cameras: points that hold views, a camera that moves, and another model that agrees."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int
from scipy.spatial.transform import Rotation

from anystyle.geometry.similarity import similarity_of_cameras
from anystyle.reconstructions.sfm.matches import VerifiedPair

Array = np.ndarray
SEEDS = 8
"""A set of views is grown from this many of the pairs that share most points."""


def supported_views(seen: Bool[Array, "P V"], least: int) -> Int[Array, " S"]:
    """The largest set of views, each of which is held in place by the others.

    A point that only two views see fixes the direction between them and says nothing of the distance. A view is held
    in place by points that at least two other views of the set see, for these have a position without it. The set
    grows from a pair, each time by the view with most such points, while there are ``least`` of them.

    Args:
        seen: Which points each view sees.
        least: How many points hold a view.
    """
    counts = seen.astype(np.int64)
    shared = np.triu(counts.T @ counts, k=1)
    best: list[int] = []
    for flat in np.argsort(-shared, axis=None, kind="stable")[:SEEDS]:
        first, second = np.unravel_index(flat, shared.shape)
        if shared[first, second] < least:
            break
        grown = _grown(seen, [int(first), int(second)], least)
        if len(grown) > len(best):
            best = grown
    return np.array(sorted(best), dtype=np.int64)


def _grown(seen: Bool[Array, "P V"], views: list[int], least: int) -> list[int]:
    while True:
        positioned = seen[:, views].sum(1) >= 2
        support = seen[positioned].sum(0)
        support[views] = 0
        if support.max(initial=0) < least:
            return views
        views = [*views, int(support.argmax())]


TRIMS = 8
"""Rounds of fitting a similarity to the views that agree best."""


class Agreement(NamedTuple):
    """Differences of views that two models have in common, after a similarity that fits most of them.

    Args:
        rotation: In degrees.
        position: As a share of the root mean square distance of the cameras from their mean.
    """

    rotation: Float64[Array, " V"]
    position: Float64[Array, " V"]

    def within(self, rotation: float, position: float) -> Bool[Array, " V"]:
        """Which views differ by no more."""
        return (self.rotation <= rotation) & (self.position <= position)


def agreement(first: Float64[Array, "V 4 4"], second: Float64[Array, "V 4 4"]) -> Agreement:
    """Compare the poses that two models give to the same views, at least 2.

    The similarity is fitted to all views and then again and again to the better half of them (at least 3), so that
    less than half of the views may be anywhere.
    """
    chosen = np.arange(len(first))
    result = _differences(first, second, chosen)
    for _ in range(TRIMS):
        cost = result.position + result.rotation / 30
        closest = np.sort(np.argsort(cost, kind="stable")[: max(3, (len(first) + 1) // 2)])
        if np.array_equal(closest, chosen):
            break
        chosen = closest
        result = _differences(first, second, chosen)
    return result


def _differences(first: Float64[Array, "V 4 4"], second: Float64[Array, "V 4 4"], chosen: Array) -> Agreement:
    similarity = similarity_of_cameras(torch.from_numpy(first[chosen]), torch.from_numpy(second[chosen]))
    moved = similarity.poses(torch.from_numpy(first)).numpy()
    turn = np.einsum("vji,vjk->vik", moved[:, :3, :3], second[:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    position = second[:, :3, 3]
    spread = np.sqrt(np.square(position - position.mean(0)).sum(1).mean())
    return Agreement(angle, np.linalg.norm(moved[:, :3, 3] - position, axis=1) / max(float(spread), 1e-12))


FOCALS = np.geomspace(0.5, 3.0, 10)
"""Focal lengths that are tried, in longer sides: how far a turn moves points depends on it."""
TOLERANCE = 0.004
"""Of a match, in longer sides: 2 pixels of 512."""
MATCHES, PAIRS = 200, 60
"""At most so many matches of at most so many pairs are looked at, evenly spaced."""
ROUNDS = 5


def share_of_rotation(pairs: Sequence[VerifiedPair], sizes: Sequence[tuple[int, int]]) -> float:
    """The share of matches that turns of the camera alone explain, in the quarter of pairs where it is smallest.

    Near 1 for a camera that turned without moving: such photographs hold no depth. A flat scene passes, since the
    homographies of a plane are no turns.

    Args:
        pairs: With matches, at least one pair.
        sizes: Height and width of what features were sought in, of each photograph.
    """
    looked_at = [pairs[index] for index in np.unique(np.linspace(0, len(pairs) - 1, PAIRS).round().astype(int))]
    shares = np.array([[_explained(pair, sizes, focal) for pair in looked_at] for focal in FOCALS])
    worst = np.sort(shares, axis=1)[:, : max(1, len(looked_at) // 4)]
    return float(worst.mean(1).max())


def _explained(pair: VerifiedPair, sizes: Sequence[tuple[int, int]], focal: float) -> float:
    """The share of a pair's matches that the best turn explains; ``focal`` is in longer sides."""
    sampled = np.unique(np.linspace(0, pair.pixels.shape[1] - 1, MATCHES).round().astype(int))
    first, second = (
        _rays(pixels, sizes[view], focal)
        for pixels, view in zip(pair.pixels[:, sampled], (pair.first, pair.second), strict=True)
    )
    bound = TOLERANCE / focal
    weight = np.ones(len(sampled))
    error = np.zeros(len(sampled))
    for _ in range(ROUNDS):
        turn = Rotation.align_vectors(second, first, weights=weight)[0]
        error = np.linalg.norm(second - turn.apply(first), axis=1)
        weight = 1 / (1 + np.square(error / bound))
    return float((error <= bound).mean())


def _rays(pixels: Float[Array, "M 2"], size: tuple[int, int], focal: float) -> Float[Array, "M 3"]:
    height, width = size
    centred = (pixels - np.array([width / 2, height / 2])) / (focal * max(size))
    rays = np.concatenate([centred, np.ones((len(pixels), 1))], axis=1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
