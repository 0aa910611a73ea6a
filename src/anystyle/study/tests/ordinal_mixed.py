"""An ordinal mixed model of single answers."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
from scipy import special

from anystyle.study import clmm
from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit
from anystyle.study.probability import log_normal_pvalue

_LARGEST_ERROR = 10.0  # logits; a flat likelihood gives larger ones


class OrdinalMixed(StudyTest):
    """A cumulative-logit model with crossed random effects of participants and items (:mod:`anystyle.study.clmm`).

    The estimate is in logits, not on the answer scale; the statistic is the signed root of the likelihood ratio.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Of the two-sided (Wald) intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response",)

    def __init__(self, *, alternative: Alternative = "less", confidence: float = 0.95) -> None:
        self.alternative: Alternative = alternative
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        """Test whether the latent preference is 0."""
        people, items = (len(np.unique(codes)) for codes in (responses.participants, responses.items))
        method = "cumulative-logit mixed model, crossed random intercepts, Laplace approximation"
        nothing = TestResult.untestable(responses, reason="", alternative=self.alternative, method=method)
        nothing = replace(nothing, unit="participant", n=people)
        if people < 2 and items < 2:
            return replace(nothing, note="one participant and one item: no random effect can be told from noise")
        if len(np.unique(responses.deviations)) < 2:
            return replace(nothing, note="every answer is the same: the model has no finite fit")
        try:
            fitted = clmm.fit(responses)
        except ValueError as error:
            return replace(nothing, note=str(error))
        if not (fitted.converged and fitted.error < _LARGEST_ERROR):
            return replace(nothing, note="the model has no finite fit; one side may have all but every answer")
        half_width = float(special.ndtri((1 + self.confidence) / 2)) * fitted.error
        interval = (fitted.preference - half_width, fitted.preference + half_width)
        spreads = f"SD {fitted.participant_sd:.2f} between participants, {fitted.item_sd:.2f} between items"
        return TestResult(
            unit="participant",
            statistic=fitted.signed_root,
            log_pvalue=log_normal_pvalue(fitted.signed_root, self.alternative),
            alternative=self.alternative,
            estimate=fitted.preference,
            interval=interval,
            effect=math.exp(fitted.preference),
            effect_name="cumulative_odds_ratio",
            effect_interval=(math.exp(interval[0]), math.exp(interval[1])),
            n=people,
            confidence=self.confidence,
            method=f"{method}; likelihood-ratio test; {spreads}; position {fitted.position:+.2f}",
            generalizes_to=("participants",) * (people > 1) + ("items",) * (items > 1),
            estimate_unit="logits",
        )
