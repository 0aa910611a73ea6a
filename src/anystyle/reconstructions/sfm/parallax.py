"""Whether a camera has moved at all, or has only turned."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from anystyle.reconstructions.sfm.matches import VerifiedPair

Array = np.ndarray
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
