"""Student's one-sample t test."""

import math
from typing import ClassVar

from anystyle_study.contract import Responses, TestResult, Unit
from anystyle_study.probability import log_t_pvalue, t_interval
from anystyle_study.significance._base import Significance


class OneSampleT(Significance):
    """Student's one-sample t test of the mean deviation; the paper runs it on single responses.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Level of the interval.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response", "participant", "item")

    def __call__(self, responses: Responses) -> TestResult:
        values, n = responses.deviations, responses.count
        method = "one-sample t test of the mean deviation"
        if n < 2:
            return self.untestable(responses, f"{n} {responses.unit}: a t test needs at least two", method)
        mean, sd = float(values.mean()), float(values.std(ddof=1))
        if sd <= 1e-14 * max(1.0, abs(mean)):
            reason = f"every {responses.unit} has the same mean: a t test needs some variation"
            return self.untestable(responses, reason, method)
        error = sd / math.sqrt(n)
        return self.result(
            responses,
            statistic=mean / error,
            log_pvalue=log_t_pvalue(mean / error, float(n - 1), self.alternative),
            estimate=mean,
            interval=t_interval(mean, error, float(n - 1), self.confidence, self.alternative),
            effect=mean / sd,
            effect_name="cohens_d",
            method=f"{method}, {n - 1} degrees of freedom",
        )
