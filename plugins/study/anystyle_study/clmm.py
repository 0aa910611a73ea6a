"""A cumulative-logit mixed model with crossed random effects, fitted by Laplace's approximation.

The model of ``clmm`` in R's package ``ordinal`` (Christensen 2022); no Python package has one with crossed
random effects. With ``y`` the deviation from the neutral answer, random effects of the answer's participant, item,
scene and style, and position c = +1 where ours is A and -1 where it is B:

    P(y <= k) = logistic(theta_k - eta),   eta = beta + delta c + sum_f sigma_f u_f,   u ~ N(0, 1)

The thresholds theta are symmetric about 0, so that ``beta = 0`` means that neither side is preferred, and ``delta``
absorbs a preference for a position.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import linalg, optimize, sparse, special

from anystyle_study.contract import Population, Responses
from anystyle_study.statistics import Crossing

_END = 500.0  # stands for an infinite threshold: its logistic is 0 or 1 to the last bit
_MAX_SIZES = 11  # distinct sizes of deviations; with more, answers are practically continuous
_MAX_LEVELS = 6000  # of all factors together; the information matrix of their effects is dense
_MAX_GRADIENT = 1e-5  # per answer, at what passes for a maximum
_STEP = 1e-4  # of finite differences of the gradient
_MAX_ERROR = 10.0  # logits; larger errors come from a flat likelihood


class NotFitted(ValueError):
    """The model cannot be fitted to these answers, for a reason given to the reader."""


@dataclass(frozen=True)
class OrdinalFit:
    """A fitted model."""

    preference: float  # ``beta`` in logits; negative prefers ours
    # its standard error from the observed information, plus a correction for the variances, which maximum likelihood
    # underestimates by one level of each factor
    error: float
    df: float  # its degrees of freedom, those of the mean answer (:mod:`anystyle_study.statistics`)
    position: float  # ``delta``; 0 if ours was always shown on one side
    sds: dict[Population, float]  # ``sigma`` of each factor, in logits
    thresholds: tuple[float, ...]  # the positive ones, ascending
    loglikelihood: float  # laplace's approximation at the maximum


@dataclass(frozen=True)
class _Terms:
    """Probability of each answer, and the logistic and its density at its upper and lower thresholds."""

    probability: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    dense_upper: np.ndarray
    dense_lower: np.ndarray

    @property
    def slope(self) -> np.ndarray:
        """Derivative of the log-probability in the linear predictor."""
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

    Parameters are one vector: preference, position (if it varies), logarithms of the threshold spacings, and the
    standard deviations of the random effects in the order of :attr:`factors`.
    """

    def __init__(self, *, responses: Responses) -> None:
        sizes, size_index = np.unique(np.abs(responses.deviations), return_inverse=True)
        self.factors = tuple(responses.factors)
        codes = list(responses.factors.values())
        self.levels = np.array([int(code.max()) + 1 for code in codes])
        if not self.factors:
            raise NotFitted("one participant and one item: no random effect can be told from noise")
        if len(np.unique(responses.deviations)) < 2:
            raise NotFitted("every answer is the same: the model has no finite fit")
        if len(sizes) > _MAX_SIZES:
            raise NotFitted(f"{len(sizes)} sizes of deviation, more than {_MAX_SIZES}: not an ordinal scale")
        if self.levels.sum() > _MAX_LEVELS:
            raise NotFitted(f"{self.levels.sum()} participants, items, scenes and styles, more than {_MAX_LEVELS}")
        n = self.count = responses.count
        # Column of each answer's effect, factor by factor, among all effects; and the indicator matrix of these.
        self._columns = np.stack(codes) + np.cumsum([0, *self.levels[:-1]])[:, None]
        rows = np.tile(np.arange(n), len(codes))
        self._members = sparse.csr_array((np.ones(rows.size), (rows, self._columns.ravel())))
        self.num_thresholds = len(sizes) - 1
        self._center = [] if sizes[0] == 0 else [0.0]
        above = self.num_thresholds + len(self._center)  # edges below the first non-negative level
        self._level = np.where(responses.deviations < 0, self.num_thresholds - size_index, above + size_index)
        position = np.zeros(n)
        if responses.ours_is_a is not None and 0 < responses.ours_is_a.sum() < n:
            position = np.where(responses.ours_is_a, 1.0, -1.0)
        self._fixed = np.stack([np.ones(n), position][: 2 if position.any() else 1])
        self.num_fixed = len(self._fixed)
        self._modes = np.zeros(int(self.levels.sum()))

    def loglikelihood(self, parameters: Float[np.ndarray, " P"]) -> tuple[float, Float[np.ndarray, " P"]]:
        """Laplace's approximation of the marginal log-likelihood, and its gradient.

        The modes of the random effects are kept as the initial values of the next call.
        """
        count = self.num_thresholds
        spacings = np.exp(parameters[self.num_fixed :][:count])
        thresholds = np.cumsum(spacings)
        edges = np.concatenate([[-_END], -thresholds[::-1], self._center, thresholds, [_END]])
        signed = parameters[-len(self.levels) :]
        sds = np.abs(signed)
        high = edges[self._level + 1] - parameters[: self.num_fixed] @ self._fixed
        low = edges[self._level] - parameters[: self.num_fixed] @ self._fixed
        terms, factor = self._find_modes(high, low, sds)
        value = np.log(terms.probability).sum() - self._modes @ self._modes / 2 - np.log(np.diag(factor)).sum()
        by_predictor, by_edges, by_sds = self._gradients(terms, factor, sds, len(edges))
        outward = (by_edges[-1 - count : -1] - by_edges[1 : 1 + count][::-1])[::-1]
        by_spacings = spacings * np.cumsum(outward)[::-1]
        by_sds *= np.where(signed < 0, -1.0, 1.0)
        return float(value), np.concatenate([self._fixed @ by_predictor, by_spacings, by_sds])

    def _find_modes(self, high: np.ndarray, low: np.ndarray, sds: np.ndarray) -> tuple[_Terms, np.ndarray]:
        """Newton's method; the joint density is log-concave, so a shortened step always climbs."""
        scale, modes = np.repeat(sds, self.levels), self._modes

        def at(effects: np.ndarray) -> tuple[float, _Terms]:
            shift = self._members @ (scale * effects)
            terms = _terms(high - shift, low - shift)
            return float(np.log(terms.probability).sum() - effects @ effects / 2), terms

        value, terms = at(modes)
        factor = self._factorise(terms.curvature, scale)
        for _ in range(100):
            uphill = scale * (self._members.T @ terms.slope) - modes
            step = linalg.cho_solve((factor, True), uphill)
            if float(step @ uphill) < 1e-12:
                break
            length, slack = 1.0, 1e-12 * abs(value)
            trial, trial_terms = at(modes + step)
            while trial < value - slack and length > 1e-8:
                length /= 2
                trial, trial_terms = at(modes + length * step)
            modes, value, terms = modes + length * step, trial, trial_terms
            factor = self._factorise(terms.curvature, scale)
        self._modes = modes
        return terms, factor

    def _factorise(self, curvature: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Cholesky factor of the information about the random effects, ``1 + S Z' W Z S``."""
        weighted = sparse.csr_array(sparse.diags_array(curvature) @ self._members)
        information = (self._members.T @ weighted).toarray() * scale * scale[:, None]
        return linalg.cholesky(information + np.eye(len(scale)), lower=True)

    def _gradients(
        self, terms: _Terms, factor: np.ndarray, sds: np.ndarray, num_edges: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives by each answer's fixed predictor, by each edge, and by the standard deviations.

        Each has three parts: of the log-density of the answers, of the log-determinant at the modes, and of the
        log-determinant through the modes (implicit differentiation).
        """
        scale = np.repeat(sds, self.levels)
        inverse = linalg.cho_solve((factor, True), np.eye(len(factor)))
        # Covariance of each factor's effect on each answer with the whole random part of that answer.
        parts = np.tensordot(sds, inverse[self._columns[None], self._columns[:, None]], 1)
        leverage = sds @ parts
        bend_upper, bend_lower = terms.dense_upper * (1 - 2 * terms.upper), terms.dense_lower * (1 - 2 * terms.lower)
        response = inverse @ (scale * (self._members.T @ (-leverage * (bend_upper + bend_lower))))
        shift = self._members @ (scale * response)

        by_predictor = terms.slope + leverage * (bend_upper + bend_lower) / 2 + shift * terms.curvature / 2
        upper_ratio, lower_ratio = terms.dense_upper / terms.probability, terms.dense_lower / terms.probability
        at_upper = upper_ratio - leverage * bend_upper / 2 - shift * terms.dense_upper / 2
        at_lower = -lower_ratio - leverage * bend_lower / 2 - shift * terms.dense_lower / 2
        by_edges = np.bincount(self._level + 1, at_upper, num_edges) + np.bincount(self._level, at_lower, num_edges)
        modes, responses = self._modes[self._columns], response[self._columns]
        by_sds = (by_predictor * modes - terms.curvature * parts - responses * terms.slope / 2).sum(1)
        return by_predictor, by_edges, by_sds


def fit(responses: Responses) -> OrdinalFit:
    """Maximise the likelihood; a second optimiser goes on if the first reaches no maximum."""
    model = OrdinalModel(responses=responses)

    def negative(parameters: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = model.loglikelihood(np.clip(parameters, -30.0, 30.0))
        return -value / model.count, -gradient / model.count

    best = np.array([0.0] * (model.num_fixed + model.num_thresholds) + [0.5] * len(model.levels))
    for method, options in (("BFGS", {"gtol": _MAX_GRADIENT / 10}), ("L-BFGS-B", {"ftol": 1e-13, "gtol": 1e-7})):
        result = optimize.minimize(negative, best, jac=True, method=method, options=options)
        best = result.x
        if np.abs(result.jac).max() < _MAX_GRADIENT:
            break
    else:
        raise NotFitted(f"the optimiser reached no maximum after {result.nit} steps: {result.message}")
    sds = np.abs(best[-len(model.levels) :])
    shares = np.array([np.square(np.bincount(codes)).sum() for codes in responses.factors.values()]) / model.count**2
    variance = _variance(model, best, sds) + float(np.sum(sds**2 * shares / (model.levels - 1)))
    if not 0 < variance < _MAX_ERROR**2:
        raise NotFitted("the likelihood is flat: one side may have all but every answer")
    return OrdinalFit(
        preference=float(best[0]),
        error=math.sqrt(variance),
        df=float(Crossing(factors=responses.factors).mean(responses.deviations).df),
        position=float(best[1]) if model.num_fixed > 1 else 0.0,
        sds=dict(zip(model.factors, sds.tolist(), strict=True)),
        thresholds=tuple(np.cumsum(np.exp(best[model.num_fixed : -len(model.levels)])).tolist()),
        loglikelihood=model.loglikelihood(best)[0],
    )


def _variance(model: OrdinalModel, best: np.ndarray, sds: np.ndarray) -> float:
    """Variance of the preference from the observed information; standard deviations at their bound of 0 are fixed."""
    moves = _STEP * np.eye(len(best))
    rows = [(model.loglikelihood(best - move)[1] - model.loglikelihood(best + move)[1]) / (2 * _STEP) for move in moves]
    information = (np.stack(rows) + np.stack(rows).T) / 2
    free = np.ones(len(best), dtype=bool)
    free[-len(sds) :] = sds >= 10 * _STEP
    try:
        return float(linalg.inv(information[np.ix_(free, free)])[0, 0])
    except linalg.LinAlgError:
        return math.nan
