"""p-values, t intervals, means over crossed random factors, standardised effects and agreement.

The mean of answers that share participants, items, scenes and styles has all of these as random factors. Variance
components are estimated by the method of moments (Henderson's method 1; Searle, Casella and McCulloch 1992, chapter 5):
in a complete table they equal those of the analysis of variance, and of REML where none is negative. Degrees of freedom
of the mean are Satterthwaite's (1946). Effects are taken over all answers, with intervals over crossed factors.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse, special

from anystyle_study.contract import Alternative, Population, Responses


def t_pvalue(statistic: float, df: float, alternative: Alternative) -> float:
    """The p-value of a t test, or of a z test with infinite degrees of freedom."""
    lower, upper = (float(special.stdtr(df, value)) for value in (statistic, -statistic))
    return {"less": lower, "greater": upper, "two-sided": min(1.0, 2 * min(lower, upper))}[alternative]


def t_interval(
    mean: float, error: float, df: float, confidence: float, alternative: Alternative = "two-sided"
) -> tuple[float, float]:
    """Confidence interval of a mean, infinite on one side for a one-sided alternative; ``nan`` without an error."""
    if not error > 0:
        return math.nan, math.nan
    half_width = float(special.stdtrit(df, (1 + confidence) / 2 if alternative == "two-sided" else confidence)) * error
    return one_sided((mean - half_width, mean + half_width), alternative)


def one_sided(interval: tuple[float, float], alternative: Alternative) -> tuple[float, float]:
    """An interval, infinite on the side that the alternative does not bound."""
    low, high = interval
    return -math.inf if alternative == "less" else low, math.inf if alternative == "greater" else high


def holm(pvalues: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment; ``nan`` stays ``nan`` and counts as no test."""
    values = np.asarray(pvalues, dtype=float)
    order = np.argsort(values, kind="stable")[: int((~np.isnan(values)).sum())]
    adjusted = np.full(len(values), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(values[order] * np.arange(len(order), 0, -1)), 1.0)
    return adjusted.tolist()


@dataclass(frozen=True)
class CrossedMean:
    """A mean over crossed random factors."""

    mean: float  # of all answers
    error: float  # its standard error for new levels of every factor; 0 if nothing varies
    df: float  # its degrees of freedom
    components: Float[np.ndarray, " F+1"]  # variance of each factor and, last, of single answers; at least 0

    def interval(self, confidence: float, alternative: Alternative = "two-sided") -> tuple[float, float]:
        """Confidence interval of the mean; ``nan`` if nothing varies."""
        return t_interval(self.mean, self.error, self.df, confidence, alternative)


class Crossing:
    """The crossing of random factors (level of each answer from 0), for the error of any mean over the same answers."""

    def __init__(self, *, factors: Mapping[Population, Int[np.ndarray, " N"]]) -> None:
        codes = list(factors.values())
        self._n = n = len(codes[0])
        self._members = [sparse.csr_array((np.ones(n), (code, np.arange(n)))) for code in codes]
        counts = [members.sum(1) for members in self._members]
        self._levels = np.array([len(count) for count in counts])
        squares = np.array([count @ count for count in counts] + [n], dtype=float)
        # E[squared sums of residuals, factor by factor] = traces @ components
        traces = np.full((len(squares),) * 2, n - 1.0)
        traces[:-1, -1] = traces[-1, :-1] = n - squares[:-1] / n
        for row, one in enumerate(self._members):
            for column, other in enumerate(self._members):
                shared = one @ other.T
                cross = counts[row] @ (shared @ counts[column])
                traces[row, column] = shared.power(2).sum() - 2 * cross / n + squares[row] * squares[column] / n**2
        # Factors that coincide, as when everybody answers once, share their variance.
        self._inverse = np.linalg.pinv(traces, rcond=1e-10)
        self._weights = self._inverse.T @ (squares / n**2)

    def mean(self, values: Float[np.ndarray, " N"]) -> CrossedMean:
        """The mean of a value for each answer."""
        mean = values.mean()
        residuals = values - mean
        sums = [((members @ residuals) ** 2).sum() for members in self._members]
        squares = np.array([*sums, (residuals**2).sum()])
        alone = squares[:-1] * (self._levels / (self._levels - 1) / self._n**2)  # if each factor were the only one
        # A variance below that of a single factor comes from a negative component.
        variance = max(self._weights @ squares, alone.max())
        with np.errstate(invalid="ignore", divide="ignore"):
            df = variance**2 / (1 / (self._levels - 1) @ alone**2)
        error = math.sqrt(variance) if variance > 1e-24 else 0.0
        return CrossedMean(float(mean), error, float(df), np.maximum(self._inverse @ squares, 0.0))


def crossed_mean(responses: Responses, values: Float[np.ndarray, " N"] | None = None) -> CrossedMean | None:
    """The mean of ``values`` (default: the deviations) over the answers' factors; ``None`` if nothing varies."""
    if not responses.factors:
        return None
    crossed = Crossing(factors=responses.factors).mean(responses.deviations if values is None else values)
    return None if crossed.error == 0 else crossed


@dataclass(frozen=True)
class Variation:
    """How answers vary, and the cost of treating them as independent."""

    # standard deviation between participants, items, scenes and styles, and of single ``answers``
    sds: dict[str, float]
    design_effect: float  # variance of the mean over that of as many independent answers
    effective_answers: float  # number of independent answers that the study is worth
    # false-positive rate of a two-sided response-level test at 5 %, by the normal approximation
    naive_error_rate: float


def variation(responses: Responses) -> Variation | None:
    """Variance components of the answers; ``None`` if there are none to estimate."""
    n, crossed = responses.count, crossed_mean(responses)
    if crossed is None or n < 3:
        return None
    effect = crossed.error**2 / (float(responses.deviations.var(ddof=1)) / n)
    sds = dict(zip([*responses.factors, "answers"], np.sqrt(crossed.components).tolist(), strict=True))
    naive_error_rate = 2 * float(special.ndtr(special.ndtri(0.025) / math.sqrt(effect)))
    return Variation(sds, design_effect=effect, effective_answers=n / effect, naive_error_rate=naive_error_rate)


@dataclass(frozen=True)
class Effect:
    """An effect over all answers."""

    name: str  # ``cohens_d`` or ``probability_of_superiority``
    estimate: float  # negative prefers ours; a probability above 1/2 does
    interval: tuple[float, float]  # confidence interval; ``nan`` if nothing varies


def superiority(responses: Responses, confidence: float = 0.95, alternative: Alternative = "two-sided") -> Effect:
    """Probability that an answer prefers ours, ties counted half."""
    preferring = (1 - np.sign(responses.deviations)) / 2
    interval = math.nan, math.nan
    if (crossed := crossed_mean(responses, preferring)) is not None:
        sides: dict[Alternative, Alternative] = {"less": "greater", "greater": "less", "two-sided": "two-sided"}
        low, high = crossed.interval(confidence, sides[alternative])
        interval = max(low, 0.0), min(high, 1.0)
    return Effect("probability_of_superiority", float(preferring.mean()), interval)


def effects(responses: Responses, confidence: float = 0.95, alternative: Alternative = "two-sided") -> list[Effect]:
    """Cohen's d (where answers vary) and the probability of superiority over all answers."""
    values, factors = responses.deviations, responses.factors
    probability = superiority(responses, confidence, alternative)
    mean, sd = float(values.mean()), float(values.std(ddof=1)) if responses.count > 1 else 0.0
    if not factors or sd <= 1e-14:
        return [probability]
    # The influence of each answer on mean / SD (the delta method).
    standard = (values - mean) / sd
    crossed = Crossing(factors=factors).mean(standard - mean / sd * (standard**2 - 1) / 2)
    interval = t_interval(mean / sd, crossed.error, crossed.df, confidence, alternative)
    return [Effect("cohens_d", mean / sd, interval), probability]


def krippendorff_alpha(counts: Float[np.ndarray, "J K"]) -> float:
    """Krippendorff's ordinal alpha of each item's (row's) counts of the answers; ``nan`` if nothing can be compared."""
    compared = counts[counts.sum(1) >= 2]
    # Each item's pairs of answers, weighted so that every answer counts once.
    weighted = compared / (compared.sum(1) - 1)[:, None]
    coincidences = weighted.T @ compared - np.diag(weighted.sum(0))
    totals = compared.sum(0)
    cumulative = np.cumsum(totals) - totals / 2
    distance = (cumulative[:, None] - cumulative[None, :]) ** 2
    expected = (totals[:, None] * totals[None, :] * distance).sum()
    return float(1 - (totals.sum() - 1) * (coincidences * distance).sum() / expected) if expected > 0 else math.nan


def agreement(responses: Responses) -> float:
    """Krippendorff's ordinal alpha over items."""
    levels, level = np.unique(responses.deviations, return_inverse=True)
    items, item = np.unique(responses.items, return_inverse=True)
    counts = np.bincount(item * len(levels) + level, minlength=len(items) * len(levels))
    return krippendorff_alpha(counts.reshape(len(items), len(levels)))
