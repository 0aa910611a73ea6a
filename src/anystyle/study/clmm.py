"""A cumulative-logit mixed model with crossed random effects, fitted by Laplace's approximation.

statsmodels fits ordinal models without random effects and linear ones with them, but no ordinal model with crossed
ones; this does. With ``y`` the deviation from the neutral answer, person p, item i and position c = +1 where ours is
A and -1 where it is B:

    P(y <= k) = logistic(theta_k - eta),   eta = beta + delta c + sigma_p u_p + sigma_i v_i,   u, v ~ N(0, 1)

The thresholds theta are symmetric about 0, so that ``beta = 0`` says exactly that neither side is preferred, and
``delta`` takes up a preference for a position.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import linalg, optimize, special

from anystyle.study.contract import Responses

_END = 500.0  # stands for an infinite threshold: its logistic is 0 or 1 to the last bit
_MAX_SIZES = 11  # distinct sizes of deviations; above, answers are as good as continuous
_MAX_CELLS = 20_000_000


@dataclass(frozen=True)
class OrdinalFit:
    """A fitted model.

    Args:
        preference: ``beta`` in logits; negative prefers ours.
        error: Its standard error, from the observed information.
        position: ``delta``; 0 where ours was always shown in one place.
        participant_sd: ``sigma_p`` in logits.
        item_sd: ``sigma_i`` in logits.
        thresholds: The positive ones, ascending.
        loglikelihood: Laplace's approximation at the maximum.
        null_loglikelihood: The same with ``beta = 0``.
        converged: Whether both maximisations say so.
    """

    preference: float
    error: float
    position: float
    participant_sd: float
    item_sd: float
    thresholds: tuple[float, ...]
    loglikelihood: float
    null_loglikelihood: float
    converged: bool

    @property
    def signed_root(self) -> float:
        """The signed square root of the likelihood-ratio statistic of ``beta = 0``; normal if it is."""
        ratio = 2 * max(self.loglikelihood - self.null_loglikelihood, 0.0)
        return math.copysign(math.sqrt(ratio), self.preference)


@dataclass(frozen=True)
class _Terms:
    """The answers' probabilities, with the logistic and its density at their upper and lower thresholds."""

    probability: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    dense_upper: np.ndarray
    dense_lower: np.ndarray

    @property
    def slope(self) -> np.ndarray:
        """The log-probability's derivative in the linear predictor."""
        return self.upper + self.lower - 1

    @property
    def curvature(self) -> np.ndarray:
        """Minus its second derivative; never negative."""
        return self.dense_upper + self.dense_lower


def _terms(high: np.ndarray, low: np.ndarray) -> _Terms:
    upper, lower, above, beyond = special.expit(high), special.expit(low), special.expit(-high), special.expit(-low)
    # The difference is taken in the tail where both are small, so that it does not cancel.
    probability = np.where(high + low > 0, beyond - above, upper - lower)
    return _Terms(np.maximum(probability, 1e-300), upper, lower, upper * above, lower * beyond)


class OrdinalModel:
    """The likelihood of one question's answers.

    Parameters are one vector: preference, position (where it varies), logarithms of the threshold spacings, and the
    random effects' standard deviations, of the larger of the two groups (participants, items) first.

    Raises:
        ValueError: The answers are no ordinal scale, or the table is too large.
    """

    def __init__(self, *, responses: Responses) -> None:
        sizes, size_index = np.unique(np.abs(responses.deviations), return_inverse=True)
        groups = [np.unique(codes, return_inverse=True)[1] for codes in (responses.participants, responses.items)]
        self.items_first = bool(groups[1].max() > groups[0].max())
        self._row, self._column = reversed(groups) if self.items_first else groups
        self._shape = int(self._row.max()) + 1, int(self._column.max()) + 1
        if len(sizes) > _MAX_SIZES:
            raise ValueError(f"{len(sizes)} sizes of deviation, more than {_MAX_SIZES}: not an ordinal scale")
        if self._shape[0] * self._shape[1] > _MAX_CELLS:
            raise ValueError(f"{self._shape[0]} x {self._shape[1]} cells, more than {_MAX_CELLS}")
        self.num_thresholds = len(sizes) - 1
        self._center = [] if sizes[0] == 0 else [0.0]
        above = self.num_thresholds + len(self._center)  # edges below the first non-negative level
        self._level = np.where(responses.deviations < 0, self.num_thresholds - size_index, above + size_index)
        position = np.zeros(responses.count)
        if responses.ours_is_a is not None and 0 < responses.ours_is_a.sum() < responses.count:
            position = np.where(responses.ours_is_a, 1.0, -1.0)
        self._fixed = np.stack([np.ones(responses.count), position][: 2 if position.any() else 1])
        self._modes = np.zeros(sum(self._shape))

    @property
    def num_fixed(self) -> int:
        """How many parameters say where the answers lie: the preference and perhaps the position."""
        return len(self._fixed)

    def loglikelihood(self, parameters: Float[np.ndarray, " P"]) -> tuple[float, Float[np.ndarray, " P"]]:
        """Laplace's approximation of the marginal log-likelihood, and its gradient.

        The random effects' modes are kept: they are the next call's start.
        """
        spacings = np.exp(parameters[self.num_fixed :][: self.num_thresholds])
        thresholds = np.cumsum(spacings)
        edges = np.concatenate([[-_END], -thresholds[::-1], self._center, thresholds, [_END]])
        sds = np.abs(parameters[-2:])
        high = edges[self._level + 1] - parameters[: self.num_fixed] @ self._fixed
        low = edges[self._level] - parameters[: self.num_fixed] @ self._fixed
        terms, inverse = self._find_modes(high, low, sds)
        value = np.log(terms.probability).sum() - self._modes @ self._modes / 2 - inverse.log_determinant / 2
        by_predictor, by_edges, by_sds = self._gradients(terms, inverse, sds, len(edges))
        count = self.num_thresholds
        outward = (by_edges[-1 - count : -1] - by_edges[1 : 1 + count][::-1])[::-1]
        by_spacings = spacings * np.cumsum(outward)[::-1]
        return float(value), np.concatenate([self._fixed @ by_predictor, by_spacings, by_sds])

    def _by_group(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sums of one value an answer over each row and over each column."""
        return np.bincount(self._row, values, self._shape[0]), np.bincount(self._column, values, self._shape[1])

    def _spread(self, effects: np.ndarray, sds: np.ndarray) -> np.ndarray:
        """The random part of each answer's linear predictor."""
        rows = self._shape[0]
        return sds[0] * effects[:rows][self._row] + sds[1] * effects[rows:][self._column]

    def _find_modes(self, high: np.ndarray, low: np.ndarray, sds: np.ndarray) -> "tuple[_Terms, _Inverse]":
        """Newton's method; the joint density is log-concave, so a shortened step always climbs."""
        modes = self._modes

        def at(effects: np.ndarray) -> tuple[float, _Terms]:
            shift = self._spread(effects, sds)
            terms = _terms(high - shift, low - shift)
            return float(np.log(terms.probability).sum() - effects @ effects / 2), terms

        value, terms = at(modes)
        inverse = self._inverse(terms.curvature, sds)
        for _ in range(100):
            by_row, by_column = self._by_group(terms.slope)
            uphill = np.concatenate([sds[0] * by_row, sds[1] * by_column]) - modes
            step = inverse.solve(uphill)
            if float(step @ uphill) < 1e-12:
                break
            length, slack = 1.0, 1e-12 * abs(value)
            trial, trial_terms = at(modes + step)
            while trial < value - slack and length > 1e-8:
                length /= 2
                trial, trial_terms = at(modes + length * step)
            modes, value, terms = modes + length * step, trial, trial_terms
            inverse = self._inverse(terms.curvature, sds)
        self._modes = modes
        return terms, inverse

    def _inverse(self, curvature: np.ndarray, sds: np.ndarray) -> "_Inverse":
        (rows, columns), (by_row, by_column) = self._shape, self._by_group(curvature)
        cross = np.bincount(self._row * columns + self._column, curvature, rows * columns).reshape(rows, columns)
        return _Inverse(1 + sds[0] ** 2 * by_row, 1 + sds[1] ** 2 * by_column, sds[0] * sds[1] * cross)

    def _gradients(
        self, terms: _Terms, inverse: "_Inverse", sds: np.ndarray, num_edges: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The derivatives by each answer's fixed predictor, by each edge, and by the standard deviations.

        Each has three parts: of the answers' log-density, of the log-determinant at the modes, and of the
        log-determinant through the modes (implicit differentiation).
        """
        row, column, rows = self._row, self._column, self._shape[0]
        row_part = sds[0] * inverse.rows[row] + sds[1] * inverse.cross[row, column]
        column_part = sds[1] * inverse.columns[column] + sds[0] * inverse.cross[row, column]
        leverage = sds[0] * row_part + sds[1] * column_part
        bend_upper, bend_lower = terms.dense_upper * (1 - 2 * terms.upper), terms.dense_lower * (1 - 2 * terms.lower)
        by_row, by_column = self._by_group(-leverage * (bend_upper + bend_lower))
        mode_response = inverse.solve(np.concatenate([sds[0] * by_row, sds[1] * by_column]))
        mode_shift = self._spread(mode_response, sds)

        by_predictor = terms.slope + leverage * (bend_upper + bend_lower) / 2 + mode_shift * terms.curvature / 2
        upper_ratio, lower_ratio = terms.dense_upper / terms.probability, terms.dense_lower / terms.probability
        at_upper = upper_ratio - leverage * bend_upper / 2 - mode_shift * terms.dense_upper / 2
        at_lower = -lower_ratio - leverage * bend_lower / 2 - mode_shift * terms.dense_lower / 2
        by_edges = np.bincount(self._level + 1, at_upper, num_edges) + np.bincount(self._level, at_lower, num_edges)
        by_sds = np.array(
            [
                (by_predictor * self._modes[:rows][row] - terms.curvature * row_part).sum(),
                (by_predictor * self._modes[rows:][column] - terms.curvature * column_part).sum(),
            ]
        )
        by_sds[0] -= (mode_response[:rows][row] * terms.slope).sum() / 2
        by_sds[1] -= (mode_response[rows:][column] * terms.slope).sum() / 2
        return by_predictor, by_edges, by_sds


class _Inverse:
    """The inverse of ``[[diag(by_row), cross], [cross', diag(by_column)]]``, through the smaller Schur complement."""

    def __init__(self, by_row: np.ndarray, by_column: np.ndarray, cross: np.ndarray) -> None:
        self._by_row, self._scaled = by_row, cross / by_row[:, None]
        factor = linalg.cholesky(np.diag(by_column) - cross.T @ self._scaled, lower=True)
        self._small = linalg.cho_solve((factor, True), np.eye(len(by_column)))
        self.log_determinant = float(np.log(by_row).sum() + 2 * np.log(np.diag(factor)).sum())

    @property
    def columns(self) -> np.ndarray:
        """The inverse's diagonal, for columns."""
        return np.diag(self._small)

    @property
    def cross(self) -> np.ndarray:
        """The inverse's block of rows by columns."""
        return -self._scaled @ self._small

    @property
    def rows(self) -> np.ndarray:
        """The inverse's diagonal, for rows."""
        return 1 / self._by_row - (self.cross * self._scaled).sum(1)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The inverse times a vector."""
        first, second = np.split(right, [len(self._by_row)])
        columns = self._small @ (second - self._scaled.T @ first)
        return np.concatenate([first / self._by_row - self._scaled @ columns, columns])


def fit(responses: Responses) -> OrdinalFit:
    """Maximise the likelihood with and without a preference.

    Raises:
        ValueError: The answers are no ordinal scale, or the table is too large.
    """
    model = OrdinalModel(responses=responses)
    bounds = [(-30.0, 30.0)] * model.num_fixed + [(-12.0, 5.0)] * model.num_thresholds + [(0.0, 30.0)] * 2
    start = np.array([0.0] * (model.num_fixed + model.num_thresholds) + [0.5, 0.5])

    def negative(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        # An answer's share: the optimiser's first step is as long as the gradient.
        value, gradient = model.loglikelihood(parameters)
        return -value / responses.count, -gradient / responses.count

    def maximise(initial: np.ndarray, limits: list[tuple[float, float]]) -> optimize.OptimizeResult:
        options = {"ftol": 1e-12, "gtol": 1e-8, "maxiter": 500}
        return optimize.minimize(negative, initial, jac=True, method="L-BFGS-B", bounds=limits, options=options)

    null = maximise(start, [(0.0, 0.0), *bounds[1:]])
    full = maximise(null.x, bounds)
    spreads = full.x[-2:][:: -1 if model.items_first else 1]
    return OrdinalFit(
        preference=float(full.x[0]),
        error=_preference_error(lambda parameters: -model.loglikelihood(parameters)[1], full.x),
        position=float(full.x[1]) if model.num_fixed > 1 else 0.0,
        participant_sd=float(spreads[0]),
        item_sd=float(spreads[1]),
        thresholds=tuple(np.cumsum(np.exp(full.x[model.num_fixed : -2])).tolist()),
        loglikelihood=-float(full.fun) * responses.count,
        null_loglikelihood=-float(null.fun) * responses.count,
        converged=bool(full.success and null.success),
    )


def _preference_error(gradient: Callable[[np.ndarray], np.ndarray], best: np.ndarray, step: float = 1e-4) -> float:
    """The standard error of the first parameter; a standard deviation at its bound of 0 is held there."""
    held = np.zeros(len(best), dtype=bool)
    held[-2:] = best[-2:] < 10 * step
    free = np.flatnonzero(~held)
    moves = step * np.eye(len(best))[free]
    information = np.stack([(gradient(best + move) - gradient(best - move))[free] / (2 * step) for move in moves])
    try:
        variance = float(linalg.inv((information + information.T) / 2)[0, 0])
    except linalg.LinAlgError:
        return math.nan
    return math.sqrt(variance) if variance > 0 else math.nan
