"""What cameras are searched with: options, pairs of photographs to match, and verified matches."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Array = np.ndarray
MIN_VIEWS = 3
"""Smaller models are dropped: a third view is the first that can contradict the others."""
EXHAUSTIVE = 300
"""Up to this many pairs (25 photographs), all pairs of unordered photographs are matched."""
NEIGHBORS = 5
"""In a video each frame is matched with this many next ones, and with those 2, 4, 8 ... times as far."""
PARTNERS, PREVIEW, RATIO, MIN_ALIKE = 10, 256, 0.8, 6
"""Of more, each is matched with its most similar ones: by at least ``MIN_ALIKE`` matches that pass the ratio test
among the ``PREVIEW`` features of largest scale."""


@dataclass(frozen=True)
class SearchOptions:
    """How cameras are searched for."""

    min_side: int = 512  # smaller photographs are enlarged to this longer side: SIFT finds few features in them
    max_side: int = 768
    num_features: int = 1500  # of each photograph, the strongest
    min_inliers: int = 15  # matches with which the incremental mapper tries to register a view
    seed: int = 0


class VerifiedPair(NamedTuple):
    """Two photographs with matches that one motion of a rigid scene explains."""

    first: int
    second: int
    pixels: Float[Array, "2 M 2"]  # of the matches in both, in the size searched


class ViewGraph(NamedTuple):
    """What is known of photographs before they are mapped."""

    names: Sequence[str]
    num_features: Sequence[int]
    sizes: Sequence[tuple[int, int]]  # height and width in which features were searched
    pairs: Sequence[VerifiedPair]


def largest_features(keypoints: Float[Array, "N 6"], descriptors: Array) -> Float[Array, "M 128"]:
    """Unit descriptors of the features of largest scale; keypoints are x, y and the rows of an affine shape."""
    scale = np.linalg.norm(keypoints[:, 2:4], axis=1)
    largest = descriptors[np.argsort(-scale, kind="stable")[:PREVIEW]].astype(np.float32)
    return largest / np.linalg.norm(largest, axis=1, keepdims=True).clip(1e-6)


def pairs_to_match(previews: Sequence[Float[Array, "_ 128"]], ordered: bool) -> list[tuple[int, int]]:
    """Pairs (first, second) with first < second that are worth matching in full.

    Few photographs are matched exhaustively. Of more, each is matched with those that share most of their largest
    features (preemptive matching, Wu, *Towards Linear-time Incremental Structure from Motion*, 3DV 2013), and in a
    video with its neighbours in time.
    """
    count = len(previews)
    pairs = list(combinations(range(count), 2))
    if len(pairs) <= EXHAUSTIVE and not ordered:
        return pairs
    chosen: set[tuple[int, int]] = set()
    if ordered:
        steps = [*range(1, NEIGHBORS + 1)]
        while 2 * steps[-1] < count:
            steps.append(2 * steps[-1])
        chosen = {(first, first + step) for step in steps for first in range(count - step)}
    if len(pairs) > EXHAUSTIVE:
        scores = np.zeros((count, count), dtype=np.int64)
        for first, second in pairs:
            scores[first, second] = scores[second, first] = _num_matches(previews[first], previews[second])
        for view, partners in enumerate(np.argsort(-scores, axis=1, kind="stable")[:, :PARTNERS].tolist()):
            similar = [other for other in partners if scores[view, other] >= MIN_ALIKE]
            chosen |= {(min(view, other), max(view, other)) for other in similar}
    return sorted(chosen)


def _num_matches(first: Float[Array, "N 128"], second: Float[Array, "M 128"]) -> int:
    """How many features of the first have a match in the second that passes the ratio test."""
    if not len(first) or len(second) < 2:
        return 0
    nearest = np.partition(2 - 2 * first @ second.T, 1, axis=1)[:, :2].clip(0)
    return int((nearest[:, 0] < RATIO**2 * nearest[:, 1]).sum())
