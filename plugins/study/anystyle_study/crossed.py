"""The mean of answers that share participants, items, scenes and styles, and its standard error.

All factors are random. Variance components are estimated by the method of moments (Henderson's method 1; Searle,
Casella and McCulloch 1992, chapter 5): in a complete table they equal those of the analysis of variance, and of REML
where none is negative. Degrees of freedom of the mean are Satterthwaite's (1946).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse, special

from anystyle_study.contract import Alternative, Population, Responses
from anystyle_study.probability import t_interval


@dataclass(frozen=True)
class CrossedMean:
    """A mean over crossed random factors; arrays if several columns of answers were given at once."""

    mean: Float[np.ndarray, "*R"]  # of all answers
    error: Float[np.ndarray, "*R"]  # its standard error for new levels of every factor; 0 if nothing varies
    df: Float[np.ndarray, "*R"]  # its degrees of freedom
    components: Float[np.ndarray, "F *R"]  # variance of each factor and, last, of single answers; at least 0

    def interval(self, confidence: float, alternative: Alternative = "two-sided") -> tuple[float, float]:
        """Confidence interval of the mean of a single column; ``nan`` if nothing varies."""
        return t_interval(float(self.mean), float(self.error), float(self.df), confidence, alternative)


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

    def mean(self, values: Float[np.ndarray, "N *R"]) -> CrossedMean:
        """The mean of ``values``, column by column if they are a matrix."""
        mean = values.mean(0)
        residuals = values - mean
        sums = [(np.asarray(members @ residuals) ** 2).sum(0) for members in self._members]
        squares = np.stack([*sums, (residuals**2).sum(0)])
        per_level = np.array(self._levels / (self._levels - 1) / self._n**2)
        alone = (squares[:-1].T * per_level).T  # the variance if each factor were the only one
        # A variance below that of one factor alone comes from a negative component.
        variance = np.maximum(np.tensordot(self._weights, squares, 1), alone.max(0))
        with np.errstate(invalid="ignore", divide="ignore"):
            df = variance**2 / np.tensordot(1 / (self._levels - 1), alone**2, 1)
        components = np.maximum(np.tensordot(self._inverse, squares, 1), 0.0)
        error = np.sqrt(np.where(variance > 1e-24, variance, 0.0))
        return CrossedMean(np.asarray(mean), np.asarray(error), np.asarray(df), components)


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
    factors, n = responses.factors, responses.count
    if not factors or n < 3:
        return None
    crossed = Crossing(factors=factors).mean(responses.deviations)
    naive = float(responses.deviations.var(ddof=1)) / n
    if crossed.error == 0 or naive <= 1e-24:
        return None
    effect = float(crossed.error) ** 2 / naive
    return Variation(
        sds=dict(zip([*factors, "answers"], np.sqrt(crossed.components).tolist(), strict=True)),
        design_effect=effect,
        effective_answers=n / effect,
        naive_error_rate=2 * float(special.ndtr(special.ndtri(0.025) / math.sqrt(effect))),
    )
