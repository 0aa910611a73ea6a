"""Wilcoxon's signed-rank test."""

import math
from typing import Any, ClassVar, Literal

import numpy as np
from scipy import stats

from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit, generalization
from anystyle.study.probability import log_normal_pvalue
from anystyle.study.signed_rank import pseudo_median


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
