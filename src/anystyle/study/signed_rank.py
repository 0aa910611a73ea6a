"""Wilcoxon's signed-rank statistics and the pseudo-median that belongs to them."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy import special
from scipy.stats import rankdata

from anystyle.study.contract import Alternative
from anystyle.study.probability import log_normal_pvalue, log_pvalue

ZeroMethod = Literal["wilcox", "pratt", "zsplit"]

_LISTED_VALUES = 200
_EXACT_UP_TO = 50  # observations; as scipy's "auto"


@dataclass(frozen=True)
class SignedRanks:
    """Rank sums of positive and negative deviations, with the null distribution's normal approximation.

    Args:
        plus: Sum of the ranks of positive deviations.
        minus: Sum of the ranks of negative deviations.
        mean: Of ``plus`` without a preference.
        sd: Of ``plus`` without a preference, corrected for ties.
        n: Deviations that were ranked.
        exact: Whether neither ties nor zeros nor too many observations rule out the exact distribution.
    """

    plus: float
    minus: float
    mean: float
    sd: float
    n: int
    exact: bool

    @property
    def rank_biserial(self) -> float:
        """Matched-pairs rank-biserial correlation in [-1, 1]; negative prefers ours."""
        return (self.plus - self.minus) / (self.plus + self.minus)

    def log_pvalue(self, alternative: Alternative, *, exact: bool) -> float:
        """The p-value's logarithm, without a continuity correction where it is approximate."""
        if not exact:
            return log_normal_pvalue((self.plus - self.mean) / self.sd, alternative)
        masses = _exact_masses(self.n)
        rank_sum = round(self.plus)
        lower, upper = masses[: rank_sum + 1].sum(), masses[rank_sum:].sum()
        return log_pvalue(math.log(min(lower, 1.0)), math.log(min(upper, 1.0)), alternative)


@lru_cache(maxsize=64)
def _exact_masses(n: int) -> np.ndarray:
    """Probabilities of the rank sums 0 .. n(n+1)/2, every sign pattern equally likely."""
    masses = np.zeros(n * (n + 1) // 2 + 1)
    masses[0] = 1.0
    for rank in range(1, n + 1):
        shifted = np.zeros_like(masses)
        shifted[rank:] = masses[:-rank]
        masses = (masses + shifted) / 2
    masses.flags.writeable = False
    return masses


def signed_ranks(deviations: Float[np.ndarray, " N"], zero_method: ZeroMethod = "wilcox") -> SignedRanks:
    """Rank the deviations by size.

    Args:
        deviations: Any real numbers.
        zero_method: ``wilcox`` drops zeros, ``pratt`` ranks and then drops them, ``zsplit`` gives half of their ranks
            to each side.
    """
    zeros = int(np.count_nonzero(deviations == 0))
    ranked = deviations[deviations != 0] if zero_method == "wilcox" else deviations
    ranks = rankdata(np.abs(ranked))
    plus, minus = float(ranks[ranked > 0].sum()), float(ranks[ranked < 0].sum())
    if zero_method == "zsplit":
        split = float(ranks[ranked == 0].sum()) / 2
        plus, minus = plus + split, minus + split
    n = len(ranked)
    mean, square = n * (n + 1) / 4, n * (n + 1) * (2 * n + 1)
    tied = np.unique(np.abs(ranked), return_counts=True)[1].astype(float)
    if zero_method == "pratt":
        mean -= zeros * (zeros + 1) / 4
        square -= zeros * (zeros + 1) * (2 * zeros + 1)
        tied = tied[1:] if zeros else tied
    square -= float((tied**3 - tied).sum()) / 2
    exact = zeros == 0 and n <= _EXACT_UP_TO and bool(np.all(tied == 1))
    return SignedRanks(plus=plus, minus=minus, mean=mean, sd=math.sqrt(max(square, 0.0) / 24), n=n, exact=exact)


def rank_biserial_interval(ranks: SignedRanks, confidence: float) -> tuple[float, float]:
    """An approximate interval of the rank-biserial correlation, on Fisher's z scale."""
    n = ranks.n
    spread = math.sqrt((2 * n**3 + 3 * n**2 + n) / 6) / ((n**2 + n) / 2)
    # Unanimous signs have no finite z: they are taken as near to unanimous as one smallest rank.
    limit = 1 - 4 / (n * (n + 1)) if n > 1 else 0.0
    center = math.atanh(min(max(ranks.rank_biserial, -limit), limit))
    reach = float(special.ndtri((1 + confidence) / 2)) * spread
    low, high = math.tanh(center - reach), math.tanh(center + reach)
    return min(low, ranks.rank_biserial), max(high, ranks.rank_biserial)


def pseudo_median(deviations: Float[np.ndarray, " N"], confidence: float) -> tuple[float, tuple[float, float]]:
    """The Hodges-Lehmann estimate and its interval: the median and two order statistics of all pairwise means.

    Where there are many different values, pairs are counted by bisection and never listed, so that memory stays linear.
    """
    n = len(deviations)
    pairs = n * (n + 1) // 2
    reach = float(special.ndtri((1 + confidence) / 2)) * math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
    outer = min(max(math.floor(pairs / 2 - reach), 1), pairs)
    wanted = np.array([(pairs + 1) // 2, pairs // 2 + 1, outer, pairs + 1 - outer])
    values, weights = np.unique(deviations, return_counts=True)
    find = _listed_means if len(values) <= _LISTED_VALUES else _counted_means
    low_median, high_median, lower, upper = (np.round(find(values, weights, wanted), 12) + 0.0).tolist()
    return (low_median + high_median) / 2, (lower, upper)


def _listed_means(values: np.ndarray, weights: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The pairwise means of the wanted ranks, from 1, each value with itself included."""
    first, second = np.triu_indices(len(values))
    means = (values[first] + values[second]) / 2
    counts = np.where(first == second, weights[first] * (weights[first] + 1) // 2, weights[first] * weights[second])
    order = np.argsort(means, kind="stable")
    return means[order][np.searchsorted(np.cumsum(counts[order]), wanted)]


def _counted_means(values: np.ndarray, weights: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The same by bisection."""
    cumulative = np.concatenate([[0], np.cumsum(weights)])
    low = np.full(len(wanted), values[0])
    high = np.full(len(wanted), values[-1])
    tolerance = 1e-14 * max(abs(values[0]), abs(values[-1]), 1.0)
    while np.any(high - low > tolerance):
        middle = (low + high) / 2
        partners = cumulative[np.searchsorted(values, 2 * middle[:, None] - values + tolerance, side="right")]
        themselves = cumulative[np.searchsorted(values, middle + tolerance, side="right")]
        enough = (partners @ weights + themselves) // 2 >= wanted
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high
