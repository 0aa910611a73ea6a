"""The sign-flip permutation test."""

import math
from typing import ClassVar

import numpy as np

from anystyle.study.contract import Alternative, Responses, StudyTest, TestResult, Unit, generalization
from anystyle.study.probability import log_pvalue
from anystyle.study.sign_flips import as_integers, exact_log_tails, random_subset_means


class SignFlip(StudyTest):
    """The permutation test that flips all answers of a participant together.

    Without a preference, every participant might as well have had ours and theirs exchanged. Exact over all sign
    patterns where the means have a common unit, as those of whole-number answers have, and by random flips otherwise.

    Args:
        alternative: ``less`` claims that ours is preferred.
        resamples: Random subsets for the interval, and for the p-value where it is not exact.
        seed: Of the random flips.
        confidence: Of the two-sided intervals.
    """

    units: ClassVar[tuple[Unit, ...]] = ("participant",)

    def __init__(
        self, *, alternative: Alternative = "less", resamples: int = 9999, seed: int = 0, confidence: float = 0.95
    ) -> None:
        self.alternative: Alternative = alternative
        self.resamples = resamples
        self.seed = seed
        self.confidence = confidence

    def __call__(self, responses: Responses) -> TestResult:
        """Test whether the mean of the rows' deviations could as well have the other sign."""
        values, n = responses.deviations, responses.count
        method = f"sign-flip permutation test over {responses.unit}s"
        if n < 2 or not np.any(values):
            reason = f"{n} {responses.unit}(s), {np.count_nonzero(values)} not neutral: there is nothing to flip"
            return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)
        sums, subset_means = random_subset_means(values, resamples=self.resamples, seed=self.seed)
        integers = as_integers(values)
        tails = None if integers is None else exact_log_tails(integers)
        how = "exact over all sign patterns"
        if tails is None:
            slack = 1e-12 * float(np.abs(values).sum())
            lower, upper = np.sum(sums <= values.sum() + slack), np.sum(sums >= values.sum() - slack)
            tails = tuple(math.log((int(count) + 1) / (self.resamples + 1)) for count in (lower, upper))
            how = f"{self.resamples} random flips"
        mean, sd = float(values.mean()), float(values.std(ddof=1))
        low, high = np.quantile(subset_means, [(1 - self.confidence) / 2, (1 + self.confidence) / 2]).tolist()
        varies = sd > 1e-14 * max(1.0, abs(mean))
        scale = 1 / sd if varies else math.nan
        return TestResult(
            unit=responses.unit,
            statistic=mean,
            log_pvalue=log_pvalue(tails[0], tails[1], self.alternative),
            alternative=self.alternative,
            estimate=mean,
            interval=(low, high),
            effect=mean * scale,
            effect_name="cohens_d",
            effect_interval=(low * scale, high * scale),
            n=n,
            confidence=self.confidence,
            method=f"{method}, {how}; interval: typical values of random subsets",
            generalizes_to=generalization(responses.unit),
        )
