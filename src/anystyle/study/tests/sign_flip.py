"""The sign-flip permutation test."""

import math
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit, generalization


class SignFlip(StudyTest):
    """scipy's permutation test of one sample, which flips all answers of a participant together.

    Without a preference, every participant might as well have had ours and theirs exchanged. Exact where there are no
    more sign patterns than ``resamples``, and by random flips otherwise. The interval's ends are quantiles of the means
    of random subsets, Hartigan's (1969) typical values: shifts that the test does not reject.

    Args:
        alternative: ``less`` claims that ours is preferred.
        resamples: Random flips, and random subsets for the interval.
        seed: Of both.
        confidence: Of the interval.
    """

    units: ClassVar[tuple[Unit, ...]] = ("participant",)

    def __init__(
        self, *, alternative: Alternative = "two-sided", resamples: int = 9999, seed: int = 0, confidence: float = 0.95
    ) -> None:
        self.alternative: Alternative = alternative
        self.resamples = resamples
        self.seed = seed
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        """Test whether the mean of the rows' deviations could as well have the other sign."""
        values, n = responses.deviations, responses.count
        method = f"sign-flip permutation test over {responses.unit}s (scipy), {min(2**n, self.resamples)} sign patterns"
        if n < 2 or not np.any(values):
            reason = f"{n} {responses.unit}(s), {np.count_nonzero(values)} not neutral: there is nothing to flip"
            return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)
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
        return TestResult(
            unit=responses.unit,
            statistic=mean,
            log_pvalue=math.log(test.pvalue),
            alternative=self.alternative,
            estimate=mean,
            interval=self._interval(values, generator),
            n=n,
            confidence=self.confidence,
            method=f"{method}; interval: typical values of random subsets",
            generalizes_to=generalization(responses.unit),
        )

    def _interval(self, values: np.ndarray, generator: np.random.Generator) -> tuple[float, float]:
        chosen = generator.random((min(self.resamples, 4_000_000 // len(values)), len(values))) < 0.5
        chosen = chosen[chosen.any(1)]
        means = chosen @ values / chosen.sum(1)
        tail = (1 - self.confidence) / (2 if self.alternative == "two-sided" else 1)
        low, high = np.quantile(means, [tail, 1 - tail]).tolist()
        low, high = min(low, float(values.mean())), max(high, float(values.mean()))
        return -math.inf if self.alternative == "less" else low, math.inf if self.alternative == "greater" else high
