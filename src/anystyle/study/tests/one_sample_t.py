"""Student's one-sample t test."""

import math
from typing import ClassVar

from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit, generalization
from anystyle.study.probability import log_t_pvalue, t_interval


class OneSampleT(StudyTest):
    """Student's one-sample t test of the mean deviation; the published test, at the level of responses.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Of the intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response", "participant", "item")

    def __init__(self, *, alternative: Alternative = "two-sided", confidence: float = 0.95) -> None:
        self.alternative: Alternative = alternative
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        values, n = responses.deviations, responses.count
        method = "one-sample t test of the mean deviation"
        if n < 2:
            reason = f"{n} {responses.unit}: a t test needs at least two"
            return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)
        mean, sd = float(values.mean()), float(values.std(ddof=1))
        if sd <= 1e-14 * max(1.0, abs(mean)):
            reason = f"every {responses.unit} has the same mean: a t test needs some variation"
            return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)
        error = sd / math.sqrt(n)
        statistic = mean / error
        return TestResult(
            unit=responses.unit,
            statistic=statistic,
            log_pvalue=log_t_pvalue(statistic, float(n - 1), self.alternative),
            alternative=self.alternative,
            estimate=mean,
            interval=t_interval(mean, error, float(n - 1), self.confidence, self.alternative),
            effect=mean / sd,
            effect_name="cohens_d",
            n=n,
            confidence=self.confidence,
            method=f"{method}, {n - 1} degrees of freedom",
            generalizes_to=generalization(responses.unit),
        )
