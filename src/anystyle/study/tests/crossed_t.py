"""The t test of a mean over crossed random factors."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit
from anystyle.study.crossed import Crossing
from anystyle.study.effects import probability_interval
from anystyle.study.probability import log_t_pvalue, t_interval


class CrossedT(StudyTest):
    """Participants, items, scenes and styles all as drawn at random (:mod:`anystyle.study.crossed`).

    Where the scenes and styles of the items are known, the claim is of new ones; otherwise of new sets of these.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Of the intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response",)

    def __init__(self, *, alternative: Alternative = "two-sided", confidence: float = 0.95) -> None:
        self.alternative: Alternative = alternative
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        factors = responses.factors
        levels = {factor: int(codes.max()) + 1 for factor, codes in factors.items()}
        people = levels.get("participants", 1)
        drawn = " x ".join(f"{count} {factor}" for factor, count in levels.items())
        method = f"t test of the mean over crossed random {drawn or 'factors'}, moment estimates"
        values = np.stack([responses.deviations, (1 - np.sign(responses.deviations)) / 2], axis=1)
        crossed = Crossing(factors=factors).mean(values) if factors else None
        if crossed is None or crossed.error[0] == 0:
            reason = f"{drawn or 'one participant, one item'}: the means do not vary, and nothing can be tested"
            untestable = TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)
            return replace(untestable, unit="participant", n=people)
        mean, error, df = (float(column[0]) for column in (crossed.mean, crossed.error, crossed.df))
        return TestResult(
            unit="participant",
            statistic=mean / error,
            log_pvalue=log_t_pvalue(mean / error, df, self.alternative),
            alternative=self.alternative,
            estimate=mean,
            interval=t_interval(mean, error, df, self.confidence, self.alternative),
            effect=float(crossed.mean[1]),
            effect_name="probability_of_superiority",
            effect_interval=probability_interval(crossed, 1, self.confidence, self.alternative),
            n=people,
            confidence=self.confidence,
            method=f"{method}, {np.round(df, 1):g} degrees of freedom (Satterthwaite)",
            generalizes_to=responses.populations,
        )
