"""A cumulative-logit mixed model with crossed random effects, fitted by Laplace's approximation.

statsmodels fits ordinal models without random effects and linear ones with them, but no ordinal model with crossed
ones; this does, as ``clmm`` of R's ``ordinal`` (Christensen 2022). With ``y`` the deviation from the neutral answer,
random effects of the answer's participant, item, scene and style, and position c = +1 where ours is A and -1 where B:

    P(y <= k) = logistic(theta_k - eta),   eta = beta + delta c + sum_f sigma_f u_f,   u ~ N(0, 1)

The thresholds theta are symmetric about 0, so that ``beta = 0`` says exactly that neither side is preferred, and
``delta`` takes up a preference for a position.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy import linalg, optimize, sparse, special

from anystyle.study.contract import Population, Responses
from anystyle.study.crossed import Crossing

_END = 500.0  # stands for an infinite threshold: its logistic is 0 or 1 to the last bit
_MAX_SIZES = 11  # distinct sizes of deviations; above, answers are as good as continuous
_MAX_CELLS = 20_000_000
_STEEPEST = 1e-5  # the gradient's largest part an answer at what passes for a maximum
_SUBSET = 10_000  # answers from which a part of the participants says where the maximum is about
_STEP = 1e-4  # of differences of the gradient


@dataclass(frozen=True)
class OrdinalFit:
    """A fitted model.

    Args:
        preference: ``beta`` in logits; negative prefers ours.
        error: Its standard error, from the observed information, with each factor's variance, which maximum
            likelihood takes too small by one of its levels, made up for.
        df: Its degrees of freedom: those of the answers' mean (:mod:`anystyle.study.crossed`).
        position: ``delta``; 0 where ours was always shown in one place.
        sds: ``sigma`` of each factor, in logits.
        thresholds: The positive ones, ascending.
        loglikelihood: Laplace's approximation at the maximum.
        failure: What the optimiser said where it ended at no maximum, else empty.
    """

    preference: float
    error: float
    df: float
    position: float
    sds: dict[Population, float]
    thresholds: tuple[float, ...]
    loglikelihood: float
    failure: str


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
    random effects' standard deviations in the order of :attr:`factors`, the one of most levels first.

    Raises:
        ValueError: The answers are no ordinal scale, or the table is too large.
    """

    def __init__(self, *, responses: Responses) -> None:
        sizes, size_index = np.unique(np.abs(responses.deviations), return_inverse=True)
        ordered = sorted(responses.factors.items(), key=lambda factor: -int(factor[1].max()))
        self.factors: tuple[Population, ...] = tuple(name for name, _ in ordered)
        self._codes = [codes for _, codes in ordered]
        self.levels = np.array([int(codes.max()) + 1 for codes in self._codes])
        cells = int(self.levels[1:].sum()) * int(self.levels.sum())
        if len(sizes) > _MAX_SIZES:
            raise ValueError(f"{len(sizes)} sizes of deviation, more than {_MAX_SIZES}: not an ordinal scale")
        if cells > _MAX_CELLS:
            raise ValueError(f"{' x '.join(map(str, self.levels))} levels make {cells} cells, more than {_MAX_CELLS}")
        n = self.count = responses.count
        self._first = sparse.csr_array((np.ones(n), (self._codes[0], np.arange(n))))
        starts = np.cumsum([0, *self.levels[1:-1]]) if len(self.levels) > 1 else np.zeros(0, dtype=int)
        self._columns = [codes + start for codes, start in zip(self._codes[1:], starts, strict=True)]
        self.num_thresholds = len(sizes) - 1
        self._center = [] if sizes[0] == 0 else [0.0]
        above = self.num_thresholds + len(self._center)  # edges below the first non-negative level
        self._level = np.where(responses.deviations < 0, self.num_thresholds - size_index, above + size_index)
        position = np.zeros(n)
        if responses.ours_is_a is not None and 0 < responses.ours_is_a.sum() < n:
            position = np.where(responses.ours_is_a, 1.0, -1.0)
        self._fixed = np.stack([np.ones(n), position][: 2 if position.any() else 1])
        self._modes = np.zeros(int(self.levels.sum()))

    @property
    def num_fixed(self) -> int:
        """How many parameters say where the answers lie: the preference and perhaps the position."""
        return len(self._fixed)

    @property
    def start(self) -> Float[np.ndarray, " P"]:
        """Parameters to begin with."""
        return np.array([0.0] * (self.num_fixed + self.num_thresholds) + [0.5] * len(self.levels))

    def loglikelihood(self, parameters: Float[np.ndarray, " P"]) -> tuple[float, Float[np.ndarray, " P"]]:
        """Laplace's approximation of the marginal log-likelihood, and its gradient.

        The random effects' modes are kept: they are the next call's start.
        """
        spacings = np.exp(parameters[self.num_fixed :][: self.num_thresholds])
        thresholds = np.cumsum(spacings)
        edges = np.concatenate([[-_END], -thresholds[::-1], self._center, thresholds, [_END]])
        sds = np.abs(parameters[-len(self.levels) :])
        high = edges[self._level + 1] - parameters[: self.num_fixed] @ self._fixed
        low = edges[self._level] - parameters[: self.num_fixed] @ self._fixed
        terms, inverse = self._find_modes(high, low, sds)
        value = np.log(terms.probability).sum() - self._modes @ self._modes / 2 - inverse.log_determinant / 2
        by_predictor, by_edges, by_sds = self._gradients(terms, inverse, sds, len(edges))
        count = self.num_thresholds
        outward = (by_edges[-1 - count : -1] - by_edges[1 : 1 + count][::-1])[::-1]
        by_spacings = spacings * np.cumsum(outward)[::-1]
        by_sds *= np.where(parameters[-len(self.levels) :] < 0, -1.0, 1.0)
        return float(value), np.concatenate([self._fixed @ by_predictor, by_spacings, by_sds])

    def _by_level(self, values: np.ndarray, sds: np.ndarray) -> np.ndarray:
        """Sums of one value an answer over each level of each factor, times the factor's standard deviation."""
        sums = [
            sd * np.bincount(codes, values, size)
            for sd, codes, size in zip(sds, self._codes, self.levels.tolist(), strict=True)
        ]
        return np.concatenate(sums)

    def _of_answers(self, effects: np.ndarray) -> list[np.ndarray]:
        """Each factor's effect on each answer, in standard deviations."""
        split = np.split(effects, np.cumsum(self.levels)[:-1])
        return [effect[codes] for effect, codes in zip(split, self._codes, strict=True)]

    def _spread(self, effects: np.ndarray, sds: np.ndarray) -> np.ndarray:
        """The random part of each answer's linear predictor."""
        return sum((sd * part for sd, part in zip(sds, self._of_answers(effects), strict=True)), np.zeros(self.count))

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
            uphill = self._by_level(terms.slope, sds) - modes
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
        sizes = self.levels[1:]
        answers, columns = np.tile(np.arange(self.count), len(sizes)), np.concatenate([[], *self._columns]).astype(int)
        shape = (self.count, int(sizes.sum()))
        weights = np.repeat(sds[1:], self.count)
        rest = sparse.csr_array((weights, (answers, columns)), shape=shape)
        weighted = sparse.csr_array((weights * np.tile(curvature, len(sizes)), (answers, columns)), shape=shape)
        return _Inverse(
            1 + sds[0] ** 2 * (self._first @ curvature),
            sparse.csr_array(sds[0] * (self._first @ weighted)),
            np.eye(shape[1]) + (rest.T @ weighted).toarray(),
        )

    def _leverages(self, inverse: "_Inverse", sds: np.ndarray) -> np.ndarray:
        """For each factor, the covariance of each answer's effect of it with the answer's whole random part."""
        first, cross, rest = inverse.blocks()
        crossed = [cross[self._codes[0], columns] for columns in self._columns]
        parts = [sds[0] * first[self._codes[0]] + sum(sd * one for sd, one in zip(sds[1:], crossed, strict=True))]
        for columns, one in zip(self._columns, crossed, strict=True):
            others = [sd * rest[columns, other] for sd, other in zip(sds[1:], self._columns, strict=True)]
            parts.append(sds[0] * one + sum(others))
        return np.stack(parts)

    def _gradients(
        self, terms: _Terms, inverse: "_Inverse", sds: np.ndarray, num_edges: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The derivatives by each answer's fixed predictor, by each edge, and by the standard deviations.

        Each has three parts: of the answers' log-density, of the log-determinant at the modes, and of the
        log-determinant through the modes (implicit differentiation).
        """
        parts = self._leverages(inverse, sds)
        leverage = sds @ parts
        bend_upper, bend_lower = terms.dense_upper * (1 - 2 * terms.upper), terms.dense_lower * (1 - 2 * terms.lower)
        response = inverse.solve(self._by_level(-leverage * (bend_upper + bend_lower), sds))
        shift = self._spread(response, sds)

        by_predictor = terms.slope + leverage * (bend_upper + bend_lower) / 2 + shift * terms.curvature / 2
        upper_ratio, lower_ratio = terms.dense_upper / terms.probability, terms.dense_lower / terms.probability
        at_upper = upper_ratio - leverage * bend_upper / 2 - shift * terms.dense_upper / 2
        at_lower = -lower_ratio - leverage * bend_lower / 2 - shift * terms.dense_lower / 2
        by_edges = np.bincount(self._level + 1, at_upper, num_edges) + np.bincount(self._level, at_lower, num_edges)
        modes, responses = self._of_answers(self._modes), self._of_answers(response)
        by_sds = [
            (by_predictor * mode - terms.curvature * part - answer * terms.slope / 2).sum()
            for mode, part, answer in zip(modes, parts, responses, strict=True)
        ]
        return by_predictor, by_edges, np.array(by_sds)


class _Inverse:
    """The inverse of ``[[diag(first), cross], [cross', rest]]``, ``cross`` sparse, through its Schur complement."""

    def __init__(self, first: np.ndarray, cross: sparse.csr_array, rest: np.ndarray) -> None:
        self._first = first
        self._scaled = sparse.csr_array(sparse.diags_array(1 / first) @ cross)
        self._factor = linalg.cholesky(rest - (cross.T @ self._scaled).toarray(), lower=True)
        self.log_determinant = float(np.log(first).sum() + 2 * np.log(np.diag(self._factor)).sum())

    def blocks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inverse: the diagonal of the first block, the block beside it, and the rest."""
        rest = linalg.cho_solve((self._factor, True), np.eye(len(self._factor)))
        cross = -(self._scaled @ rest)
        return 1 / self._first - np.asarray(self._scaled.multiply(cross).sum(1)).ravel(), cross, rest

    def solve(self, right: np.ndarray) -> np.ndarray:
        """The inverse times a vector."""
        first, second = np.split(right, [len(self._first)])
        columns = linalg.cho_solve((self._factor, True), second - self._scaled.T @ first)
        return np.concatenate([first / self._first - self._scaled @ columns, columns])


def fit(responses: Responses) -> OrdinalFit:
    """Maximise the likelihood; a second optimiser goes on where the first ends at no maximum.

    Raises:
        ValueError: The answers are no ordinal scale, or the table is too large.
    """
    model = OrdinalModel(responses=responses)
    best, failure = _maximise(model, *_about(responses, model))
    information = _information(model, best)
    spreads = np.abs(best[-len(model.levels) :])
    parts = [
        sd**2 * float(np.square(np.bincount(codes)).sum()) / model.count**2
        for sd, codes in zip(spreads, (responses.factors[name] for name in model.factors), strict=True)
    ]
    freedom = model.levels - 1
    variance = _variance(information, spreads) + float(np.sum(np.array(parts) / freedom))
    return OrdinalFit(
        preference=float(best[0]),
        error=math.sqrt(variance) if variance > 0 else math.nan,
        df=float(Crossing(factors=responses.factors).mean(responses.deviations).df),
        position=float(best[1]) if model.num_fixed > 1 else 0.0,
        sds=dict(zip(model.factors, spreads.tolist(), strict=True)),
        thresholds=tuple(np.cumsum(np.exp(best[model.num_fixed : -len(model.levels)])).tolist()),
        loglikelihood=model.loglikelihood(best)[0],
        failure=failure,
    )


def _about(responses: Responses, model: OrdinalModel) -> tuple[np.ndarray, np.ndarray]:
    """Where to start, and a guess of the inverse information an answer: those of some of the participants."""
    every = responses.count // _SUBSET
    if every < 2:
        return model.start, np.eye(len(model.start))
    rows = responses.participants % every == 0
    subset = replace(
        responses,
        deviations=responses.deviations[rows],
        participants=responses.participants[rows],
        items=responses.items[rows],
        ours_is_a=None if responses.ours_is_a is None else responses.ours_is_a[rows],
    )
    small = OrdinalModel(responses=subset)
    if (small.factors, len(small.start)) != (model.factors, len(model.start)):
        return model.start, np.eye(len(model.start))
    best, _ = _maximise(small, small.start, np.eye(len(small.start)))
    values, vectors = linalg.eigh(_information(small, best) / small.count)
    return best, (vectors / np.maximum(values, 1e-3)) @ vectors.T


def _maximise(model: OrdinalModel, start: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, str]:
    def negative(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = model.loglikelihood(np.clip(parameters, -30.0, 30.0))
        return -value / model.count, -gradient / model.count

    tries = (("BFGS", {"gtol": _STEEPEST / 10, "hess_inv0": inverse}), ("L-BFGS-B", {"ftol": 1e-13, "gtol": 1e-7}))
    best, said = start, ""
    for method, options in tries:
        result = optimize.minimize(negative, best, jac=True, method=method, options=options)
        best, said = result.x, f"{method} ended after {result.nit} steps: {result.message}"
        if np.abs(result.jac).max() < _STEEPEST:
            return best, ""
    return best, said


def _information(model: OrdinalModel, best: np.ndarray) -> np.ndarray:
    moves = _STEP * np.eye(len(best))
    rows = [(model.loglikelihood(best - move)[1] - model.loglikelihood(best + move)[1]) / (2 * _STEP) for move in moves]
    information = np.stack(rows)
    return (information + information.T) / 2


def _variance(information: np.ndarray, spreads: np.ndarray) -> float:
    """The preference's variance; a standard deviation at its bound of 0 is held there."""
    free = np.ones(len(information), dtype=bool)
    free[-len(spreads) :] = spreads >= 10 * _STEP
    try:
        return float(linalg.inv(information[np.ix_(free, free)])[0, 0])
    except linalg.LinAlgError:
        return math.nan
