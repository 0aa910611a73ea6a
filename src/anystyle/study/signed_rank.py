"""Wilcoxon's signed-rank test, and the pseudo-median that belongs to it."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy import special, stats

from anystyle.study.contract import Alternative
from anystyle.study.probability import log_normal_pvalue

ZeroMethod = Literal["wilcox", "pratt", "zsplit"]

_EXACT_UP_TO = 50  # observations; as scipy's "auto" without ties


@dataclass(frozen=True)
class SignedRanks:
    """A signed-rank test.

    Args:
        plus: Sum of the ranks of positive deviations.
        n: Deviations that were ranked.
        rank_biserial: Matched-pairs rank-biserial correlation in [-1, 1]; negative prefers ours.
        log_pvalue: Natural logarithm of the p-value.
        exact: Whether that is of the exact distribution.
    """

    plus: float
    n: int
    rank_biserial: float
    log_pvalue: float
    exact: bool


def signed_ranks(
    deviations: Float[np.ndarray, " N"],
    alternative: Alternative,
    zero_method: ZeroMethod = "wilcox",
    method: Literal["auto", "approx"] = "auto",
) -> SignedRanks:
    """Test the symmetry of deviations about 0 by scipy.

    Args:
        deviations: Any real numbers, not all of them 0.
        alternative: The claim.
        zero_method: ``wilcox`` drops zeros, ``pratt`` ranks and then drops them, ``zsplit`` gives half of their ranks
            to each side.
        method: ``auto`` is exact without ties or zeros up to 50 observations; otherwise the normal approximation with
            the correction for ties and none for continuity.
    """
    zeros = int(np.count_nonzero(deviations == 0))
    n = len(deviations) - (zeros if zero_method == "wilcox" else 0)
    total = n * (n + 1) / 2 - (zeros * (zeros + 1) / 2 if zero_method == "pratt" else 0)
    # One-sided, so that the statistic is the positive rank sum and z keeps its sign.
    normal: Any = stats.wilcoxon(
        deviations, zero_method=zero_method, correction=False, alternative="less", method="asymptotic"
    )
    distinct = len(np.unique(np.abs(deviations))) == len(deviations)
    exact = method == "auto" and zeros == 0 and distinct and n <= _EXACT_UP_TO
    if exact:
        result: Any = stats.wilcoxon(deviations, alternative=alternative, method="exact")
        log_pvalue = math.log(result.pvalue)
    else:
        log_pvalue = log_normal_pvalue(float(normal.zstatistic), alternative)
    plus = float(normal.statistic)
    return SignedRanks(plus, n, (2 * plus - total) / total, log_pvalue, exact)


def rank_biserial_interval(ranks: SignedRanks, confidence: float) -> tuple[float, float]:
    """An approximate interval of the rank-biserial correlation, on Fisher's z scale."""
    n = ranks.n
    spread = math.sqrt((2 * n**3 + 3 * n**2 + n) / 6) / ((n**2 + n) / 2)
    # Unanimous signs have no finite z: they are taken as near to unanimous as one smallest rank.
    limit = 1 - 4 / (n * (n + 1)) if n > 1 else 0.0
    center = math.atanh(min(max(ranks.rank_biserial, -limit), limit))
    half_width = float(special.ndtri((1 + confidence) / 2)) * spread
    low, high = math.tanh(center - half_width), math.tanh(center + half_width)
    return min(low, ranks.rank_biserial), max(high, ranks.rank_biserial)


def pseudo_median(deviations: Float[np.ndarray, " N"], confidence: float) -> tuple[float, tuple[float, float]]:
    """The Hodges-Lehmann estimate and its interval: the median and two order statistics of all pairwise means.

    Pairs are counted by bisection and never listed, so that memory stays linear.
    """
    n = len(deviations)
    pairs = n * (n + 1) // 2
    half_width = float(special.ndtri((1 + confidence) / 2)) * math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
    outer = min(max(math.floor(pairs / 2 - half_width), 1), pairs)
    ranks = np.array([(pairs + 1) // 2, pairs // 2 + 1, outer, pairs + 1 - outer])
    low_median, high_median, lower, upper = (np.round(_pairwise_means(deviations, ranks), 12) + 0.0).tolist()
    return (low_median + high_median) / 2, (lower, upper)


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
