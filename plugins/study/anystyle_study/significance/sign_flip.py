"""The sign-flip permutation test."""

import math
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from anystyle_study.contract import Alternative, Responses, TestResult, Unit
from anystyle_study.significance._base import Significance


class SignFlip(Significance):
    """scipy's one-sample permutation test, which flips the sign of each participant's mean.

    It is exact if there are at most ``resamples`` sign patterns, and draws random flips otherwise. The interval's ends
    are quantiles of the means of random subsets, the typical values of Hartigan (1969).

    Args:
        alternative: ``less`` claims that ours is preferred.
        resamples: Number of random flips, and of random subsets for the interval.
        seed: Of both.
        confidence: Level of the interval.
    """

    units: ClassVar[tuple[Unit, ...]] = ("participant",)

    def __init__(
        self, *, alternative: Alternative = "two-sided", resamples: int = 9999, seed: int = 0, confidence: float = 0.95
    ) -> None:
        super().__init__(alternative=alternative, confidence=confidence)
        self.resamples = resamples
        self.seed = seed

    def __call__(self, responses: Responses) -> TestResult:
        values, n = responses.deviations, responses.count
        method = f"sign-flip permutation test over {responses.unit}s (scipy), {min(2**n, self.resamples)} sign patterns"
        if n < 2 or not np.any(values):
            reason = f"{n} {responses.unit}(s), {np.count_nonzero(values)} not neutral: there is nothing to flip"
            return self.untestable(responses, reason, method)
        generator = np.random.default_rng(self.seed)
        test: Any = stats.permutation_test(
            (values,),
            lambda flipped, axis: flipped.mean(axis),
            permutation_type="samples",
            vectorized=True,
            n_resamples=self.resamples,
            alternative=self.alternative,
            rng=generator,
            batch=max(1, 4_000_000 // n),
        )
        mean = float(values.mean())
        chosen = generator.random((min(self.resamples, 4_000_000 // n), n)) < 0.5
        chosen = chosen[chosen.any(1)]
        tail = (1 - self.confidence) / (2 if self.alternative == "two-sided" else 1)
        low, high = np.quantile(chosen @ values / chosen.sum(1), [tail, 1 - tail]).tolist()
        low = -math.inf if self.alternative == "less" else min(low, mean)
        high = math.inf if self.alternative == "greater" else max(high, mean)
        return self.result(
            responses,
            statistic=mean,
            log_pvalue=math.log(test.pvalue),
            estimate=mean,
            interval=(low, high),
            method=f"{method}; interval: typical values of random subsets",
        )
