"""The t test of a mean over crossed random factors."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from anystyle_study.contract import Responses, TestResult, Unit
from anystyle_study.crossed import Crossing
from anystyle_study.effects import superiority
from anystyle_study.probability import log_t_pvalue
from anystyle_study.significance._base import Significance


class CrossedT(Significance):
    """t test of the mean with participants, items, scenes and styles as random factors.

    See :mod:`anystyle_study.crossed`. The claim generalises to new scenes and styles if those of the items are known,
    otherwise to new sets of the same scenes and styles.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Level of the intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response",)

    def __call__(self, responses: Responses) -> TestResult:
        factors = responses.factors
        levels = {factor: int(codes.max()) + 1 for factor, codes in factors.items()}
        people = levels.get("participants", 1)
        drawn = " x ".join(f"{count} {factor}" for factor, count in levels.items())
        method = f"t test of the mean over crossed random {drawn or 'factors'}, moment estimates"
        crossed = Crossing(factors=factors).mean(responses.deviations) if factors else None
        if crossed is None or crossed.error == 0:
            reason = f"{drawn or 'one participant, one item'}: the means do not vary, and nothing can be tested"
            return replace(self.untestable(responses, reason, method), unit="participant", n=people)
        statistic, df = float(crossed.mean / crossed.error), float(crossed.df)
        effect = superiority(responses, self.confidence, self.alternative)
        return self.result(
            responses,
            unit="participant",
            statistic=statistic,
            log_pvalue=log_t_pvalue(statistic, df, self.alternative),
            estimate=float(crossed.mean),
            interval=crossed.interval(self.confidence, self.alternative),
            effect=effect.estimate,
            effect_name=effect.name,
            effect_interval=effect.interval,
            n=people,
            method=f"{method}, {np.round(df, 1):g} degrees of freedom (Satterthwaite)",
            generalizes_to=responses.populations,
        )
