"""Wilcoxon's signed-rank test."""

from typing import ClassVar, Literal

import numpy as np

from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit, generalization
from anystyle.study.signed_rank import ZeroMethod, pseudo_median, rank_biserial_interval, signed_ranks


class Wilcoxon(StudyTest):
    """Wilcoxon's signed-rank test of symmetry about the neutral answer; published at the level of responses.

    The statistic is the rank sum of the positive deviations, as scipy's for one-sided alternatives.

    Args:
        alternative: ``less`` claims that ours is preferred.
        zero_method: What becomes of neutral answers: dropped, ranked and then dropped, or split between the sides.
        method: ``auto`` is exact without ties or zeros up to 50 observations and otherwise the normal approximation
            with the correction for ties and none for continuity.
        confidence: Of the two-sided intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response", "participant", "item")

    def __init__(
        self,
        *,
        alternative: Alternative = "less",
        zero_method: ZeroMethod = "wilcox",
        method: Literal["auto", "approx"] = "auto",
        confidence: float = 0.95,
    ) -> None:
        self.alternative: Alternative = alternative
        self.zero_method: ZeroMethod = zero_method
        self.method: Literal["auto", "approx"] = method
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        """Test whether positive and negative deviations balance."""
        name = f"Wilcoxon signed-rank test, zero_method={self.zero_method}"
        if responses.count < 2 or not np.any(responses.deviations):
            reason = f"{responses.count} {responses.unit}(s), {np.count_nonzero(responses.deviations)} not neutral: "
            reason += "nothing to rank"
            return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=name)
        ranks = signed_ranks(responses.deviations, self.alternative, self.zero_method, self.method)
        median, interval = pseudo_median(responses.deviations, self.confidence)
        how = "exact distribution" if ranks.exact else "normal approximation with tie correction"
        return TestResult(
            unit=responses.unit,
            statistic=ranks.plus,
            log_pvalue=ranks.log_pvalue,
            alternative=self.alternative,
            estimate=median,
            interval=interval,
            effect=ranks.rank_biserial,
            effect_name="rank_biserial",
            effect_interval=rank_biserial_interval(ranks, self.confidence),
            n=responses.count,
            confidence=self.confidence,
            method=f"{name}, {how}, {ranks.n} ranked; estimate: Hodges-Lehmann pseudo-median",
            generalizes_to=generalization(responses.unit),
        )
