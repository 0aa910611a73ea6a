"""An ordinal mixed model of single answers."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from anystyle.study import clmm
from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit
from anystyle.study.probability import log_t_pvalue, t_interval

_LARGEST_ERROR = 10.0  # logits; a flat likelihood gives larger ones


class OrdinalMixed(StudyTest):
    """A cumulative-logit model, participants, items, scenes and styles as random effects (:mod:`anystyle.study.clmm`).

    The estimate is in logits, not on the answer scale; the statistic is Wald's, on Satterthwaite's degrees of freedom.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Of the interval.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response",)

    def __init__(self, *, alternative: Alternative = "two-sided", confidence: float = 0.95) -> None:
        self.alternative: Alternative = alternative
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        people = len(np.unique(responses.participants))
        method = "cumulative-logit mixed model, crossed random intercepts, Laplace approximation"
        untestable = TestResult.untestable(responses, reason="", alternative=self.alternative, method=method)
        untestable = replace(untestable, unit="participant", n=people)
        if not responses.factors:
            return replace(untestable, note="one participant and one item: no random effect can be told from noise")
        if len(np.unique(responses.deviations)) < 2:
            return replace(untestable, note="every answer is the same: the model has no finite fit")
        try:
            fitted = clmm.fit(responses)
        except ValueError as error:
            return replace(untestable, note=str(error))
        if fitted.failure:
            return replace(untestable, note=f"the optimiser reached no maximum: {fitted.failure}")
        if not fitted.error < _LARGEST_ERROR:
            return replace(untestable, note="the likelihood is flat: one side may have all but every answer")
        low, high = t_interval(fitted.preference, fitted.error, fitted.df, self.confidence, self.alternative)
        spreads = ", ".join(f"{sd:.2f} between {factor}" for factor, sd in fitted.sds.items())
        statistic = fitted.preference / fitted.error
        return TestResult(
            unit="participant",
            statistic=statistic,
            log_pvalue=log_t_pvalue(statistic, fitted.df, self.alternative),
            alternative=self.alternative,
            estimate=fitted.preference,
            interval=(low, high),
            effect=math.exp(fitted.preference),
            effect_name="cumulative_odds_ratio",
            effect_interval=(math.exp(low), math.exp(high)),
            n=people,
            confidence=self.confidence,
            method=f"{method}; Wald test, {fitted.df:.1f} degrees of freedom; SD {spreads}; "
            f"position {fitted.position:+.2f}",
            generalizes_to=responses.populations,
            estimate_unit="logits",
        )
