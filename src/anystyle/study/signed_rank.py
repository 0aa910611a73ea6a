"""The pseudo-median that belongs to Wilcoxon's signed-rank test, which scipy does not give."""

import math

import numpy as np
from jaxtyping import Float
from scipy import special

from anystyle.study.contract import Alternative

_EXACT_UP_TO = 50  # observations, as the test


def pseudo_median(
    deviations: Float[np.ndarray, " N"], confidence: float, alternative: Alternative = "two-sided"
) -> tuple[float, tuple[float, float]]:
    """The Hodges-Lehmann estimate and its interval: the median and order statistics of all pairwise means.

    The interval inverts the test (Hollander, Wolfe and Chicken 2014, section 3.3); where ties leave it no width it is
    ``nan``. Pairs are counted by bisection and never listed, so that memory stays linear.
    """
    n = len(deviations)
    pairs = n * (n + 1) // 2
    tail = (1 - confidence) / (2 if alternative == "two-sided" else 1)
    outer = min(max(_quantile(n, tail), 1), pairs)
    ranks = np.array([(pairs + 1) // 2, pairs // 2 + 1, outer, pairs + 1 - outer])
    low_median, high_median, lower, upper = (np.round(_pairwise_means(deviations, ranks), 12) + 0.0).tolist()
    median = (low_median + high_median) / 2
    if lower == upper:
        return median, (math.nan, math.nan)
    return median, (-math.inf if alternative == "less" else lower, math.inf if alternative == "greater" else upper)


def _quantile(n: int, tail: float) -> int:
    """The smallest rank sum whose distribution function without ties reaches ``tail``, as R's ``qsignrank``."""
    if n > _EXACT_UP_TO:
        center, sd = n * (n + 1) / 4, math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
        return math.floor(center + float(special.ndtri(tail)) * sd)
    ways = np.ones(1)
    for rank in range(1, n + 1):
        ways = (np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))) / 2
    return int(np.searchsorted(np.cumsum(ways), tail))


def _pairwise_means(deviations: np.ndarray, ranks: np.ndarray) -> np.ndarray:
    """The pairwise means of given ranks, from 1, each value with itself included, by bisection."""
    values, weights = np.unique(deviations, return_counts=True)
    cumulative = np.concatenate([[0], np.cumsum(weights)])
    low = np.full(len(ranks), values[0])
    high = np.full(len(ranks), values[-1])
    tolerance = 1e-14 * max(abs(values[0]), abs(values[-1]), 1.0)
    while np.any(high - low > tolerance):
        middle = (low + high) / 2
        partners = cumulative[np.searchsorted(values, 2 * middle[:, None] - values + tolerance, side="right")]
        themselves = cumulative[np.searchsorted(values, middle + tolerance, side="right")]
        enough = (partners @ weights + themselves) // 2 >= ranks
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high
