"""Wilcoxon's signed-rank test, and the pseudo-median that belongs to it, which scipy does not give."""

import math
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from scipy import special, stats

from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit, generalization
from anystyle.study.probability import log_normal_pvalue


class Wilcoxon(StudyTest):
    """scipy's signed-rank test of symmetry about the neutral answer; published at the level of responses.

    The statistic is the rank sum of the positive deviations, as scipy's for one-sided alternatives; the effect is the
    matched-pairs rank-biserial correlation.

    Args:
        alternative: ``less`` claims that ours is preferred.
        zero_method: What becomes of neutral answers: dropped, ranked and then dropped, or split between the sides.
        method: ``auto`` is exact without ties or zeros up to 50 observations and otherwise the normal approximation
            with the correction for ties and none for continuity.
        confidence: Of the interval.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response", "participant", "item")

    def __init__(
        self,
        *,
        alternative: Alternative = "two-sided",
        zero_method: Literal["wilcox", "pratt", "zsplit"] = "wilcox",
        method: Literal["auto", "approx"] = "auto",
        confidence: float = 0.95,
    ) -> None:
        self.alternative: Alternative = alternative
        self.zero_method: Literal["wilcox", "pratt", "zsplit"] = zero_method
        self.method: Literal["auto", "approx"] = method
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        """Test whether positive and negative deviations balance."""
        values, name = responses.deviations, f"Wilcoxon signed-rank test (scipy), zero_method={self.zero_method}"
        zeros = int(np.count_nonzero(values == 0))
        if responses.count < 2 or zeros == responses.count:
            reason = f"{responses.count} {responses.unit}(s), {responses.count - zeros} not neutral: nothing to rank"
            return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=name)
        ranked = len(values) - zeros * (self.zero_method == "wilcox")
        total = ranked * (ranked + 1) / 2 - (zeros * (zeros + 1) / 2 if self.zero_method == "pratt" else 0)
        # One-sided, so that the statistic is the positive rank sum and z keeps its sign.
        normal: Any = stats.wilcoxon(
            values, zero_method=self.zero_method, correction=False, alternative="less", method="asymptotic"
        )
        exact = self.method == "auto" and not zeros and ranked <= 50 and len(np.unique(np.abs(values))) == ranked
        log_pvalue = log_normal_pvalue(float(normal.zstatistic), self.alternative)
        if exact:
            result: Any = stats.wilcoxon(values, alternative=self.alternative, method="exact")
            log_pvalue = math.log(result.pvalue)
        median, interval = pseudo_median(values, self.confidence, self.alternative)
        how = "exact distribution" if exact else "normal approximation with tie correction"
        return TestResult(
            unit=responses.unit,
            statistic=float(normal.statistic),
            log_pvalue=log_pvalue,
            alternative=self.alternative,
            estimate=median,
            interval=interval,
            effect=(2 * float(normal.statistic) - total) / total,
            effect_name="rank_biserial",
            n=responses.count,
            confidence=self.confidence,
            method=f"{name}, {how}, {ranked} ranked; estimate: Hodges-Lehmann pseudo-median",
            note="ties leave the Hodges-Lehmann interval without any width: none is given" * math.isnan(interval[0]),
            generalizes_to=generalization(responses.unit),
        )


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
