"""The built-in tests of a user study."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from scipy import special, stats

from anystyle.ranges import AtLeastOne, Range
from anystyle_study.contract import Alternative, Responses, StudyTest, TestResult, Unit, generalization
from anystyle_study.statistics import crossed_mean, one_sided, superiority, t_interval, t_pvalue


@dataclass(kw_only=True)
class Significance(StudyTest):
    """A test with an alternative hypothesis and a confidence level.

    Args:
        alternative: ``less`` claims that ours is preferred.
        confidence: Level of the intervals.
    """

    alternative: Alternative = "two-sided"
    confidence: Annotated[float, Range(gt=0, lt=1)] = 0.95

    def result(self, responses: Responses, **values: Any) -> TestResult:
        """A result with this test's options; ``values`` are the other fields and may override the defaults."""
        unit = responses.unit
        defaults = {"unit": unit, "n": responses.count, "generalizes_to": generalization(unit)}
        return TestResult(alternative=self.alternative, confidence=self.confidence, **(defaults | values))

    def untestable(self, responses: Responses, reason: str, method: str) -> TestResult:
        """A result without a p-value."""
        return TestResult.untestable(responses, reason=reason, alternative=self.alternative, method=method)


class CrossedT(Significance):
    """t test of the mean with participants, items, scenes and styles as random factors.

    See :mod:`anystyle_study.statistics`. The claim generalises to new scenes and styles if those of the items are
    known, otherwise to new sets of the same scenes and styles.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response",)

    def __call__(self, responses: Responses) -> TestResult:
        levels = {factor: int(codes.max()) + 1 for factor, codes in responses.factors.items()}
        people = levels.get("participants", 1)
        drawn = " x ".join(f"{count} {factor}" for factor, count in levels.items())
        method = f"t test of the mean over crossed random {drawn or 'factors'}, moment estimates"
        if (crossed := crossed_mean(responses)) is None:
            reason = f"{drawn or 'one participant, one item'}: the means do not vary, and nothing can be tested"
            return replace(self.untestable(responses, reason, method), unit="participant", n=people)
        statistic = crossed.mean / crossed.error
        effect = superiority(responses, self.confidence, self.alternative)
        return self.result(
            responses,
            unit="participant",
            statistic=statistic,
            pvalue=t_pvalue(statistic, crossed.df, self.alternative),
            estimate=crossed.mean,
            interval=crossed.interval(self.confidence, self.alternative),
            effect=effect.estimate,
            effect_name=effect.name,
            effect_interval=effect.interval,
            n=people,
            method=f"{method}, {np.round(crossed.df, 1):g} degrees of freedom (Satterthwaite)",
            generalizes_to=responses.populations,
        )


class OneSampleT(Significance):
    """Student's one-sample t test of the mean deviation; the paper runs it on single responses."""

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
        # SciPy's own test takes milliseconds to look at its arguments, and power is found by thousands of tests.
        error, df = sd / math.sqrt(n), n - 1
        return self.result(
            responses,
            statistic=mean / error,
            pvalue=t_pvalue(mean / error, df, self.alternative),
            estimate=mean,
            interval=t_interval(mean, error, df, self.confidence, self.alternative),
            effect=mean / sd,
            effect_name="cohens_d",
            method=f"{method}, {df} degrees of freedom",
        )


@dataclass(kw_only=True)
class SignFlip(Significance):
    """scipy's one-sample permutation test, which flips the sign of each participant's mean.

    It is exact if there are at most ``resamples`` sign patterns, and draws random flips otherwise. The interval's ends
    are order statistics of the means of all subsets, or of random ones, the typical values of Hartigan (1969); too few
    participants have none.

    Args:
        resamples: Number of random flips, and of random subsets for the interval.
        seed: Seed of flips and subsets.
    """

    units: ClassVar[tuple[Unit, ...]] = ("participant",)

    resamples: AtLeastOne = 9999
    seed: int = 0

    def __call__(self, responses: Responses) -> TestResult:
        values, n = responses.deviations, responses.count
        method = f"sign-flip permutation test over {responses.unit}s (scipy), {min(2**n, self.resamples)} sign patterns"
        if n < 2 or not np.any(values):
            reason = f"{n} {responses.unit}(s), {np.count_nonzero(values)} not neutral: there is nothing to flip"
            return self.untestable(responses, reason, method)
        generator = np.random.default_rng(self.seed)
        batch = max(1, 4_000_000 // n)
        options = {"n_resamples": self.resamples, "alternative": self.alternative, "rng": generator, "batch": batch}
        test: Any = stats.permutation_test((values,), np.mean, permutation_type="samples", **options)
        mean = float(values.mean())
        if exact := 2**n <= min(self.resamples, 4_000_000 // n):
            chosen = np.arange(2**n)[:, None] >> np.arange(n) & 1
        else:
            chosen = generator.random((min(self.resamples, 4_000_000 // n), n)) < 0.5
        chosen = chosen[chosen.any(1)]
        means = np.sort(chosen @ values / chosen.sum(1))
        tail = (1 - self.confidence) / (2 if self.alternative == "two-sided" else 1)
        # The true mean lies between any two neighbours of n ordered ones with probability 1 / (n + 1).
        rank = math.floor(tail * (len(means) + 1) + 1e-9)
        ends = min(float(means[rank - 1]), mean), max(float(means[-rank]), mean)
        return self.result(
            responses,
            statistic=mean,
            pvalue=float(test.pvalue),
            estimate=mean,
            interval=one_sided(ends, self.alternative) if rank else (math.nan, math.nan),
            method=f"{method}; interval: typical values of subsets",
            note="" if rank else f"too few {'participants' if exact else 'resamples'} for an interval of this level",
        )


_MAX_EXACT = 50  # observations without ties or zeros
_MAX_PERMUTED = 13  # observations with ties or zeros


@dataclass(kw_only=True)
class Wilcoxon(Significance):
    """scipy's signed-rank test of symmetry about the neutral answer; the paper runs it on single responses.

    The statistic is the rank sum of the positive deviations; the effect is the matched-pairs rank-biserial correlation.

    Args:
        zero_method: Neutral answers are dropped, ranked and then dropped, or split between the sides.
        method: ``auto`` is exact up to 50 observations without ties or zeros and up to 13 with some, and otherwise
            ``approx``, the normal approximation with tie correction and without continuity correction.
    """

    units: ClassVar[tuple[Unit, ...]] = ("response", "participant", "item")

    zero_method: Literal["wilcox", "pratt", "zsplit"] = "wilcox"
    method: Literal["auto", "approx"] = "auto"

    def __call__(self, responses: Responses) -> TestResult:
        values, name = responses.deviations, f"Wilcoxon signed-rank test (scipy), zero_method={self.zero_method}"
        zeros = int(np.count_nonzero(values == 0))
        if responses.count < 2 or zeros == responses.count:
            reason = f"{responses.count} {responses.unit}(s), {responses.count - zeros} not neutral: nothing to rank"
            return self.untestable(responses, reason, name)
        ranked = len(values) - zeros * (self.zero_method == "wilcox")
        total = ranked * (ranked + 1) / 2 - (zeros * (zeros + 1) / 2 if self.zero_method == "pratt" else 0)
        # One-sided, so that the statistic is the positive rank sum and z keeps its sign.
        normal: Any = stats.wilcoxon(values, zero_method=self.zero_method, alternative="less", method="asymptotic")
        tied = zeros > 0 or len(np.unique(np.abs(values))) < ranked
        if self.method == "auto" and not tied and ranked <= _MAX_EXACT:
            result: Any = stats.wilcoxon(values, alternative=self.alternative, method="exact")
            pvalue, how = float(result.pvalue), "exact distribution"
        elif self.method == "auto" and tied and responses.count <= _MAX_PERMUTED:
            pvalue, how = self._permuted(values), "all sign patterns"
        else:
            pvalue = t_pvalue(float(normal.zstatistic), math.inf, self.alternative)
            how = "normal approximation with tie correction"
        median, interval = pseudo_median(values, self.confidence, self.alternative)
        flat = math.isnan(interval[0])
        return self.result(
            responses,
            statistic=float(normal.statistic),
            pvalue=pvalue,
            estimate=median,
            interval=interval,
            effect=(2 * float(normal.statistic) - total) / total,
            effect_name="rank_biserial",
            method=f"{name}, {how}, {ranked} ranked; estimate: Hodges-Lehmann pseudo-median",
            note="no Hodges-Lehmann interval: ties leave it no width, or there are too few answers" if flat else "",
        )

    def _permuted(self, values: Float[np.ndarray, " N"]) -> float:
        """The p-value over all signs of the ranks; SciPy's ``PermutationMethod`` takes a thousand times as long."""
        considered = values[values != 0] if self.zero_method == "wilcox" else values
        ranks = stats.rankdata(np.abs(considered))[considered != 0]
        observed = ranks[considered[considered != 0] > 0].sum()
        sums = (np.arange(2 ** len(ranks))[:, None] >> np.arange(len(ranks)) & 1) @ ranks
        below, above = float(np.mean(sums <= observed)), float(np.mean(sums >= observed))
        return {"less": below, "greater": above, "two-sided": min(1.0, 2 * min(below, above))}[self.alternative]


def pseudo_median(
    deviations: Float[np.ndarray, " N"], confidence: float, alternative: Alternative = "two-sided"
) -> tuple[float, tuple[float, float]]:
    """The Hodges-Lehmann estimate and its interval: the median and order statistics of all pairwise means.

    The interval inverts the test (Hollander, Wolfe and Chicken 2014, section 3.3); it is ``nan`` if ties leave it no
    width, or deviations are too few for the confidence. Memory is quadratic in the number of distinct values, not of
    answers.
    """
    n = len(deviations)
    pairs = n * (n + 1) // 2
    tail = (1 - confidence) / (2 if alternative == "two-sided" else 1)
    outer = min(max(least := _quantile(n, tail), 1), pairs)
    ranks = np.array([(pairs + 1) // 2, pairs // 2 + 1, outer, pairs + 1 - outer])
    values, weights = np.unique(deviations, return_counts=True)
    rows, columns = np.triu_indices(len(values))
    averages = (values[rows] + values[columns]) / 2
    times = np.where(rows == columns, weights[rows] * (weights[rows] + 1) // 2, weights[rows] * weights[columns])
    order = np.argsort(averages)
    found = averages[order][np.searchsorted(np.cumsum(times[order]), ranks)]
    low_median, high_median, lower, upper = (np.round(found, 12) + 0.0).tolist()
    interval = (math.nan, math.nan) if lower == upper or least < 1 else one_sided((lower, upper), alternative)
    return (low_median + high_median) / 2, interval


def _quantile(n: int, tail: float) -> int:
    """Quantile of the signed-rank distribution without ties, as R's ``qsignrank``; normal approximation for large n."""
    if n > _MAX_EXACT:
        center, sd = n * (n + 1) / 4, math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
        return math.floor(center + float(special.ndtri(tail)) * sd)
    ways = np.ones(1)
    for rank in range(1, n + 1):
        ways = (np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))) / 2
    return int(np.searchsorted(np.cumsum(ways), tail))
