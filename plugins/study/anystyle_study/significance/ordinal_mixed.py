"""An ordinal mixed model of single answers."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from anystyle_study import clmm
from anystyle_study.contract import Responses, TestResult, Unit
from anystyle_study.probability import log_t_pvalue, t_interval
from anystyle_study.significance._base import Significance


class OrdinalMixed(Significance):
    """Cumulative-logit model with participants, items, scenes and styles as random effects.

    See :mod:`anystyle_study.clmm`. The estimate is in logits, not on the answer scale; the test is Wald's, on
    Satterthwaite's degrees of freedom.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Level of the intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response",)

    def __call__(self, responses: Responses) -> TestResult:
        people = len(np.unique(responses.participants))
        method = "cumulative-logit mixed model, crossed random intercepts, Laplace approximation"
        try:
            fitted = clmm.fit(responses)
        except clmm.NotFitted as error:
            return replace(self.untestable(responses, str(error), method), unit="participant", n=people)
        low, high = t_interval(fitted.preference, fitted.error, fitted.df, self.confidence, self.alternative)
        spreads = ", ".join(f"{sd:.2f} between {factor}" for factor, sd in fitted.sds.items())
        statistic = fitted.preference / fitted.error
        return self.result(
            responses,
            unit="participant",
            statistic=statistic,
            log_pvalue=log_t_pvalue(statistic, fitted.df, self.alternative),
            estimate=fitted.preference,
            interval=(low, high),
            effect=math.exp(fitted.preference),
            effect_name="cumulative_odds_ratio",
            effect_interval=(math.exp(low), math.exp(high)),
            n=people,
            method=f"{method}; Wald test, {fitted.df:.1f} degrees of freedom; SD {spreads}; "
            f"position {fitted.position:+.2f}",
            generalizes_to=responses.populations,
            estimate_unit="logits",
        )
