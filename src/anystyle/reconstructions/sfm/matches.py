"""Features of photographs, the matches of pairs, and which pairs are worth matching in full."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass(frozen=True)
class Features:
    """Features of one photograph in pixels of its enlargement.

    Args:
        keypoints: x, y, scale and orientation.
        descriptors: Of unit norm.
    """

    keypoints: Float[Array, "N 4"]
    descriptors: Float[Array, "N 128"]


@dataclass(frozen=True)
class VerifiedPair:
    """Two photographs with matches that one motion of a rigid scene explains.

    Args:
        first: Index of a photograph.
        second: Likewise.
        pixels: Where each match is in the first and in the second, in pixels of their enlargements.
    """

    first: int
    second: int
    pixels: Float[Array, "2 M 2"]


EXHAUSTIVE = 300
"""Up to so many pairs (of 25 photographs) all are matched."""
NEIGHBORS = 5
"""In a video each frame is matched with so many next ones, and with those 2, 4, 8 ... times as far."""
PARTNERS = 10
"""Photographs in no order, and frames where a path returns, are matched with so many that look most alike."""
PREVIEW = 256
"""Features of the largest scale that a quick look compares."""
RATIO = 0.8
"""A match of the quick look is nearer than this share of the distance of the next best."""
LEAST_ALIKE = 6
"""Matches of a quick look that are taken for a sign of overlap."""


def pairs_to_match(features: Sequence[Features], ordered: bool) -> list[tuple[int, int]]:
    """Pairs (first, second) with first < second.

    Few photographs are matched exhaustively. Of more, each is matched with those that share most of their largest
    features (preemptive matching, Wu, *Towards Linear-time Incremental Structure from Motion*, 3DV 2013), and in a
    video with its neighbours in time.

    Args:
        features: Of each photograph.
        ordered: Whether the photographs are a path, as frames of a video are.
    """
    count = len(features)
    every = list(combinations(range(count), 2))
    if len(every) <= EXHAUSTIVE and not ordered:
        return every
    chosen = set(_neighbors(count)) if ordered else set()
    if len(every) > EXHAUSTIVE:
        chosen |= _alike([_largest(one) for one in features], every)
    return sorted(chosen)


def _neighbors(count: int) -> list[tuple[int, int]]:
    steps = [*range(1, NEIGHBORS + 1)]
    while 2 * steps[-1] < count:
        steps.append(2 * steps[-1])
    return [(first, first + step) for step in steps for first in range(count - step)]


def _largest(features: Features) -> Float[Array, "M 128"]:
    return features.descriptors[np.argsort(-features.keypoints[:, 2], kind="stable")[:PREVIEW]]


def _alike(previews: list[Float[Array, "_ 128"]], pairs: list[tuple[int, int]]) -> set[tuple[int, int]]:
    scores = np.zeros((len(previews), len(previews)), dtype=np.int64)
    for first, second in pairs:
        scores[first, second] = scores[second, first] = _num_matches(previews[first], previews[second])
    best = np.argsort(-scores, axis=1, kind="stable")[:, :PARTNERS]
    return {
        (min(view, int(other)), max(view, int(other)))
        for view, partners in enumerate(best)
        for other in partners
        if scores[view, other] >= LEAST_ALIKE
    }


def _num_matches(first: Float[Array, "N 128"], second: Float[Array, "M 128"]) -> int:
    """How many features of the first have one match in the second that stands out."""
    if not len(first) or len(second) < 2:
        return 0
    nearest = np.sort(2 - 2 * first @ second.T, axis=1)[:, :2].clip(0)
    return int((nearest[:, 0] < RATIO**2 * nearest[:, 1]).sum())
