"""The distribution of a sum whose terms' signs are all equally likely.

scipy's ``permutation_test`` is exact where it can list all sign patterns, to about 16 terms; this is exact for whole
numbers of any count, and gives logarithms of tails below the smallest double.
"""

import math
from fractions import Fraction

import numpy as np
from jaxtyping import Float
from scipy import optimize, special

_MAX_GRID = 200_000  # cells of the exact distribution's table
_MAX_WORK = 400_000_000  # cells times terms
_CHUNK_NUMBERS = 4_000_000


def as_integers(values: Float[np.ndarray, " N"], largest: int = 1_000_000) -> np.ndarray | None:
    """The smallest whole numbers proportional to ``values``; ``None`` where they have no small common unit.

    Means of whole-number answers have one: the least common multiple of how many were averaged.
    """
    fractions = [Fraction(value).limit_denominator(10_000) for value in values.tolist()]
    unit = math.lcm(*(fraction.denominator for fraction in fractions))
    if unit > largest or not np.allclose(np.array([float(f) for f in fractions]), values, rtol=0, atol=1e-12):
        return None
    integers = np.array([int(fraction * unit) for fraction in fractions], dtype=np.int64)
    return integers // max(int(np.gcd.reduce(np.abs(integers))), 1)


def exact_log_tails(integers: np.ndarray) -> tuple[float, float] | None:
    """Logarithms of P(S <= s) and P(S >= s) for the observed sum s, over all sign patterns; ``None`` if too many.

    The distribution is built under tilted signs, which make the observed sum the expected one, and tilted back:
    nothing underflows, however small the probability.
    """
    sizes = np.abs(integers)
    sizes, total = sizes[sizes > 0], int(integers.sum())
    if 2 * sizes.sum() + 1 > _MAX_GRID or (2 * sizes.sum() + 1) * len(sizes) > _MAX_WORK:
        return None
    return _log_lower_tail(sizes, total), _log_lower_tail(sizes, -total)


def _log_lower_tail(sizes: np.ndarray, observed: int) -> float:
    """The logarithm of P(S <= observed)."""
    span = int(sizes.sum())
    tilt = _tilt(sizes, min(observed, 0), span)
    # Under the tilt a term is positive with probability 1 / (1 + exp(-2 tilt size)).
    up = special.expit(2 * tilt * sizes)
    masses = np.zeros(2 * span + 1)
    masses[span] = 1.0
    reached = 0
    for size, probability in zip(sizes.tolist(), up.tolist(), strict=True):
        low, high = span - reached, span + reached + 1
        old = masses[low:high].copy()
        masses[low:high] = 0.0
        masses[low - size : high - size] += (1 - probability) * old
        masses[low + size : high + size] += probability * old
        reached += size
    sums = np.arange(-span, observed + 1)
    # P(S = x) = tilted mass * exp(-tilt x) * prod cosh(tilt size)
    log_weights = -tilt * (sums - observed)
    weights = masses[: len(sums)] * np.exp(np.minimum(log_weights, 0.0))
    log_cosh = np.abs(tilt) * sizes + np.log1p(np.exp(-2 * np.abs(tilt) * sizes)) - math.log(2)
    return min(math.log(float(weights.sum())) - tilt * observed + float(log_cosh.sum()), 0.0)


def _tilt(sizes: np.ndarray, observed: int, span: int) -> float:
    """The tilt, at most 0, under which the expected sum is as near to ``observed`` as a moderate tilt brings it."""
    limit = -30.0 / float(sizes.min())
    if observed == 0:
        return 0.0
    if float(sizes @ np.tanh(limit * sizes)) >= observed or observed <= -span:
        return limit
    solution = optimize.root_scalar(lambda tilt: float(sizes @ np.tanh(tilt * sizes)) - observed, bracket=(limit, 0.0))
    return float(solution.root)


def random_subset_means(
    values: Float[np.ndarray, " N"], *, resamples: int, seed: int
) -> tuple[Float[np.ndarray, " R"], Float[np.ndarray, " S"]]:
    """Sums under random signs, and means of the subsets whose signs were flipped.

    The subset means are Hartigan's typical values: their quantiles are the interval of shifts that the sign-flip test
    does not reject.
    """
    generator = np.random.default_rng(seed)
    chunk = max(1, _CHUNK_NUMBERS // len(values))
    sums: list[np.ndarray] = []
    means: list[np.ndarray] = []
    for start in range(0, resamples, chunk):
        flipped = generator.random((min(chunk, resamples - start), len(values))) < 0.5
        flipped_sums, counts = flipped @ values, flipped.sum(1)
        sums.append(values.sum() - 2 * flipped_sums)
        means.append(flipped_sums[counts > 0] / counts[counts > 0])
    return np.concatenate(sums), np.concatenate(means)
