"""Which views of a sparse model are held in place by enough points."""

import numpy as np
from jaxtyping import Bool, Int

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
