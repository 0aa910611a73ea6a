"""The two-way cluster bootstrap."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np

from anystyle.study.bootstrap import Bootstrap, bootstrap_mean, tabulate
from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit
from anystyle.study.probability import log_pvalue

_EFFECT_SHARE = 5  # an interval needs fewer resamples than a small p-value


class ClusterBootstrap(StudyTest):
    """Resample participants and items together, and studentise: valid for new participants and new items at once.

    Args:
        alternative: ``less`` claims that ours is preferred.
        resamples: How many; a p-value is never below ``1 / (resamples + 1)``.
        seed: Of the resampling.
        confidence: Of the two-sided intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response",)

    def __init__(
        self, *, alternative: Alternative = "less", resamples: int = 9999, seed: int = 0, confidence: float = 0.95
    ) -> None:
        self.alternative: Alternative = alternative
        self.resamples = resamples
        self.seed = seed
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        """Test whether the mean deviation is 0, participants and items both drawn at random."""
        people, items = (len(np.unique(codes)) for codes in (responses.participants, responses.items))
        method = f"studentised two-way cluster bootstrap, {people} participants x {items} items"
        bootstrap = bootstrap_mean(tabulate(responses), resamples=self.resamples, seed=self.seed)
        if bootstrap is None:
            reason = (
                f"{people} participant(s) and {items} item(s) whose means do not vary: there is nothing to resample"
            )
            nothing = TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)
            return replace(nothing, unit="participant", n=people)
        superiority = bootstrap_mean(
            tabulate(responses, -np.sign(responses.deviations) / 2),
            resamples=max(self.resamples // _EFFECT_SHARE, 99),
            seed=self.seed,
        )
        lower, upper = bootstrap.tails()
        return TestResult(
            unit="participant",
            statistic=bootstrap.mean / bootstrap.error,
            log_pvalue=log_pvalue(math.log(lower), math.log(upper), self.alternative),
            alternative=self.alternative,
            estimate=bootstrap.mean,
            interval=bootstrap.interval(self.confidence),
            effect=float(np.mean((1 - np.sign(responses.deviations)) / 2)),
            effect_name="probability_of_superiority",
            effect_interval=(math.nan, math.nan) if superiority is None else _superiority(superiority, self.confidence),
            n=people,
            confidence=self.confidence,
            method=f"{method}, {self.resamples} resamples; p is at least {1 / (self.resamples + 1):.2g}",
            generalizes_to=("participants",) * (people > 1) + ("items",) * (items > 1),
        )


def _superiority(bootstrap: Bootstrap, confidence: float) -> tuple[float, float]:
    low, high = bootstrap.interval(confidence)
    return max(low + 0.5, 0.0), min(high + 0.5, 1.0)
