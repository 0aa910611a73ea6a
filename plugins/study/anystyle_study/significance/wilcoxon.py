"""Wilcoxon's signed-rank test, with the Hodges-Lehmann estimate, which scipy lacks."""

import math
from typing import Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from scipy import special, stats

from anystyle_study.contract import Alternative, Responses, TestResult, Unit
from anystyle_study.probability import log_t_pvalue
from anystyle_study.significance._base import Significance

_MAX_EXACT = 50  # observations


class Wilcoxon(Significance):
    """scipy's signed-rank test of symmetry about the neutral answer; the paper runs it on single responses.

    The statistic is the rank sum of the positive deviations; the effect is the matched-pairs rank-biserial correlation.

    Args:
        alternative: ``less`` claims that ours is preferred.
        zero_method: Neutral answers are dropped, ranked and then dropped, or split between the sides.
        method: ``auto`` is exact up to 50 observations without ties or zeros, and otherwise ``approx``, the normal
            approximation with tie correction and without continuity correction.
        confidence: Level of the interval.
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
        super().__init__(alternative=alternative, confidence=confidence)
        self.zero_method: Literal["wilcox", "pratt", "zsplit"] = zero_method
        self.method: Literal["auto", "approx"] = method

    def __call__(self, responses: Responses) -> TestResult:
        values, name = responses.deviations, f"Wilcoxon signed-rank test (scipy), zero_method={self.zero_method}"
        zeros = int(np.count_nonzero(values == 0))
        if responses.count < 2 or zeros == responses.count:
            reason = f"{responses.count} {responses.unit}(s), {responses.count - zeros} not neutral: nothing to rank"
            return self.untestable(responses, reason, name)
        ranked = len(values) - zeros * (self.zero_method == "wilcox")
        total = ranked * (ranked + 1) / 2 - (zeros * (zeros + 1) / 2 if self.zero_method == "pratt" else 0)
        # One-sided, so that the statistic is the positive rank sum and z keeps its sign.
        normal: Any = stats.wilcoxon(
            values, zero_method=self.zero_method, correction=False, alternative="less", method="asymptotic"
        )
        exact = (
            self.method == "auto" and not zeros and ranked <= _MAX_EXACT and len(np.unique(np.abs(values))) == ranked
        )
        log_pvalue = log_t_pvalue(float(normal.zstatistic), math.inf, self.alternative)
        if exact:
            result: Any = stats.wilcoxon(values, alternative=self.alternative, method="exact")
            log_pvalue = math.log(result.pvalue)
        median, interval = pseudo_median(values, self.confidence, self.alternative)
        how = "exact distribution" if exact else "normal approximation with tie correction"
        return self.result(
            responses,
            statistic=float(normal.statistic),
            log_pvalue=log_pvalue,
            estimate=median,
            interval=interval,
            effect=(2 * float(normal.statistic) - total) / total,
            effect_name="rank_biserial",
            method=f"{name}, {how}, {ranked} ranked; estimate: Hodges-Lehmann pseudo-median",
            note="ties leave the Hodges-Lehmann interval without any width: none is given" * math.isnan(interval[0]),
        )


def pseudo_median(
    deviations: Float[np.ndarray, " N"], confidence: float, alternative: Alternative = "two-sided"
) -> tuple[float, tuple[float, float]]:
    """The Hodges-Lehmann estimate and its interval: the median and order statistics of all pairwise means.

    The interval inverts the test (Hollander, Wolfe and Chicken 2014, section 3.3); it is ``nan`` if ties leave it no
    width. Memory is quadratic in the number of distinct values, not of answers.
    """
    n = len(deviations)
    pairs = n * (n + 1) // 2
    tail = (1 - confidence) / (2 if alternative == "two-sided" else 1)
    outer = min(max(_quantile(n, tail), 1), pairs)
    ranks = np.array([(pairs + 1) // 2, pairs // 2 + 1, outer, pairs + 1 - outer])
    values, weights = np.unique(deviations, return_counts=True)
    rows, columns = np.triu_indices(len(values))
    averages = (values[rows] + values[columns]) / 2
    times = np.where(rows == columns, weights[rows] * (weights[rows] + 1) // 2, weights[rows] * weights[columns])
    order = np.argsort(averages)
    found = averages[order][np.searchsorted(np.cumsum(times[order]), ranks)]
    low_median, high_median, lower, upper = (np.round(found, 12) + 0.0).tolist()
    median = (low_median + high_median) / 2
    if lower == upper:
        return median, (math.nan, math.nan)
    return median, (-math.inf if alternative == "less" else lower, math.inf if alternative == "greater" else upper)


def _quantile(n: int, tail: float) -> int:
    """Quantile of the signed-rank distribution without ties, as R's ``qsignrank``; normal approximation for large n."""
    if n > _MAX_EXACT:
        center, sd = n * (n + 1) / 4, math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
        return math.floor(center + float(special.ndtri(tail)) * sd)
    ways = np.ones(1)
    for rank in range(1, n + 1):
        ways = (np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))) / 2
    return int(np.searchsorted(np.cumsum(ways), tail))
