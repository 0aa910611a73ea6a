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
import torch
from jaxtyping import Float
from scipy import linalg, optimize
from torch import Tensor

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
    loglikelihood: float  # Laplace's approximation at the maximum


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
            raise NotFitted("one participant and one item: random effects cannot be separated from noise")
        if len(np.unique(responses.deviations)) < 2:
            raise NotFitted("every answer is the same: the model has no finite fit")
        if len(sizes) > _MAX_SIZES:
            raise NotFitted(f"{len(sizes)} sizes of deviation, more than {_MAX_SIZES}: not an ordinal scale")
        if self.levels.sum() > _MAX_LEVELS:
            raise NotFitted(f"{self.levels.sum()} participants, items, scenes and styles, more than {_MAX_LEVELS}")
        n = self.count = responses.count
        # The place of each answer's effects among all effects, and of pairs of them in the matrix of their information.
        size = int(self.levels.sum())
        self._places = torch.from_numpy(np.stack(codes) + np.cumsum([0, *self.levels[:-1]])[:, None])
        self._pairs = (self._places[:, None] * size + self._places).flatten()
        self.num_thresholds = len(sizes) - 1
        self._center = torch.zeros(int(sizes[0] != 0), dtype=torch.float64)
        above = self.num_thresholds + len(self._center)  # edges below the first non-negative level
        self._level = torch.from_numpy(
            np.where(responses.deviations < 0, self.num_thresholds - size_index, above + size_index)
        )
        position = np.zeros(n)
        if responses.ours_is_a is not None and 0 < responses.ours_is_a.sum() < n:
            position = np.where(responses.ours_is_a, 1.0, -1.0)
        self._fixed = torch.from_numpy(np.stack([np.ones(n), position][: 2 if position.any() else 1]))
        self.num_fixed = len(self._fixed)
        self._modes = torch.zeros(size, dtype=torch.float64)

    def loglikelihood(self, parameters: Float[np.ndarray, " P"]) -> tuple[float, Float[np.ndarray, " P"]]:
        """Laplace's approximation of the marginal log-likelihood, and its gradient.

        The modes of the random effects are kept as the initial values of the next call.
        """
        place = torch.tensor(parameters, dtype=torch.float64, requires_grad=True)
        thresholds = place[self.num_fixed :][: self.num_thresholds].exp().cumsum(0)
        end = place.new_tensor([_END])
        edges = torch.cat([-end, -thresholds.flip(0), self._center, thresholds, end])
        predictor = place[: self.num_fixed] @ self._fixed
        high, low = edges[self._level + 1] - predictor, edges[self._level] - predictor
        scale = place[-len(self.levels) :].abs().repeat_interleave(torch.from_numpy(self.levels))
        self._modes = self._find_modes(high, low, scale)
        # One more step of Newton's method moves nothing at the modes, and gives them their derivatives.
        _, uphill, factor = self._joint(high, low, scale, self._modes)
        value, _, factor = self._joint(high, low, scale, self._modes + _solve(factor, uphill))
        value = value - factor.diagonal().log().sum()
        (gradient,) = torch.autograd.grad(value, place)
        return float(value.detach()), gradient.numpy()

    def _joint(self, high: Tensor, low: Tensor, scale: Tensor, effects: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Logarithm of the density of answers and effects, its gradient by the effects, and a Cholesky factor.

        The factor is of their information, ``1 + S Z' W Z S``.
        """
        shift = (scale * effects)[self._places].sum(0)
        high, low = high - shift, low - shift
        upper, lower, above, beyond = high.sigmoid(), low.sigmoid(), (-high).sigmoid(), (-low).sigmoid()
        # The difference is taken in the tail where both are small, so that it does not cancel.
        probability = torch.where(high + low > 0, beyond - above, upper - lower).clamp_min(1e-300)
        value = probability.log().sum() - effects @ effects / 2
        slope, curvature = upper + lower - 1, upper * above + lower * beyond
        size, factors = len(scale), len(self.levels)
        uphill = scale.new_zeros(size).index_add(0, self._places.flatten(), slope.repeat(factors)) * scale - effects
        information = scale.new_zeros(size**2).index_add(0, self._pairs, curvature.repeat(factors**2)).view(size, size)
        information = information * scale * scale[:, None] + torch.eye(size).to(scale)
        return value, uphill, torch.linalg.cholesky(information)

    @torch.no_grad()
    def _find_modes(self, high: Tensor, low: Tensor, scale: Tensor) -> Tensor:
        """Newton's method; the joint density is log-concave, so a shortened step always climbs."""
        modes = self._modes
        value, uphill, factor = self._joint(high, low, scale, modes)
        for _ in range(100):
            step = _solve(factor, uphill)
            if float(step @ uphill) < 1e-12:
                break
            least = value - 1e-12 * abs(value)
            trial = self._joint(high, low, scale, modes + step)
            while trial[0] < least and float(step.abs().max()) > 1e-12:
                step = step / 2
                trial = self._joint(high, low, scale, modes + step)
            modes, (value, uphill, factor) = modes + step, trial
        return modes


def _solve(factor: Tensor, vector: Tensor) -> Tensor:
    return torch.cholesky_solve(vector[:, None], factor)[:, 0]


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
        df=Crossing(factors=responses.factors).mean(responses.deviations).df,
        position=float(best[1]) if model.num_fixed > 1 else 0.0,
        sds=dict(zip(model.factors, sds.tolist(), strict=True)),
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
