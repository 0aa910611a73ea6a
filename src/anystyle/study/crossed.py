"""The mean of answers that share participants, items, scenes and styles, and how well it is known.

Each factor's levels are taken as drawn at random. The variance components are the method of moments' (Henderson's
method 1; Searle, Casella and McCulloch 1992, chapter 5): in a complete table they are those of the analysis of
variance, and of REML where none is negative. The mean's degrees of freedom are Satterthwaite's (1946).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse, special

from anystyle.study.contract import Population, Responses


@dataclass(frozen=True)
class CrossedMean:
    """A mean over crossed factors; arrays where several columns of answers were given at once.

    Args:
        mean: Of all answers.
        error: Its standard error for new levels of every factor; 0 where nothing varies.
        df: Its degrees of freedom.
        components: The variance of each factor and, last, of single answers; not below 0.
    """

    mean: Float[np.ndarray, "*R"]
    error: Float[np.ndarray, "*R"]
    df: Float[np.ndarray, "*R"]
    components: Float[np.ndarray, "F *R"]


class Crossing:
    """Which answers share what.

    Args:
        factors: The level of each answer in each factor, from 0.
    """

    def __init__(self, *, factors: Mapping[Population, Int[np.ndarray, " N"]]) -> None:
        if not factors:
            raise ValueError("no factor has two levels: there is nothing that varies at random")
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
        # Factors that coincide, as where everybody answers once, share their variance.
        self._inverse = np.linalg.pinv(traces, rcond=1e-10)
        self._weights = self._inverse.T @ (squares / n**2)

    def mean(self, values: Float[np.ndarray, "N *R"]) -> CrossedMean:
        """The mean of ``values``; of each column if they are a matrix."""
        mean = values.mean(0)
        residuals = values - mean
        sums = [(np.asarray(members @ residuals) ** 2).sum(0) for members in self._members]
        squares = np.stack([*sums, (residuals**2).sum(0)])
        per_level = np.array(self._levels / (self._levels - 1) / self._n**2)
        alone = (squares[:-1].T * per_level).T  # each factor as if it were the only one
        # One factor alone already says as much; an estimate below that has a negative component in it.
        variance = np.maximum(np.tensordot(self._weights, squares, 1), alone.max(0))
        with np.errstate(invalid="ignore", divide="ignore"):
            df = variance**2 / np.tensordot(1 / (self._levels - 1), alone**2, 1)
        components = np.maximum(np.tensordot(self._inverse, squares, 1), 0.0)
        error = np.sqrt(np.where(variance > 1e-24, variance, 0.0))
        return CrossedMean(np.asarray(mean), np.asarray(error), np.asarray(df), components)


@dataclass(frozen=True)
class Variation:
    """Where answers vary, and what it costs to count every answer as independent.

    Args:
        sds: Standard deviation between the true means of participants, items, scenes and styles, as far as they are
            told apart; ``answers`` is that of single answers besides.
        design_effect: How much larger the variance of the mean is than that of as many independent answers.
        effective_answers: As how many independent answers the study counts.
        naive_error_rate: How often a two-sided response-level test at 5 % would reject without any preference, by
            the normal approximation, in a study that varies as this one does.
    """

    sds: dict[str, float]
    design_effect: float
    effective_answers: float
    naive_error_rate: float


def variation(responses: Responses) -> Variation | None:
    """Split the variance; ``None`` where there is none, or one participant and one item only."""
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
