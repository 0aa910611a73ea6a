"""Tail probabilities as logarithms, so that no p-value underflows; what to do with many of them; and intervals."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from anystyle.study.contract import Alternative

# Below this the plain function may have lost digits or become 0, and the series for the logarithm is exact.
_LEAST_EXACT = 1e-280


def log_t_cdf(statistic: float, df: float) -> float:
    """Natural logarithm of Student's t distribution function, exact far into the lower tail."""
    plain = float(special.stdtr(df, statistic))
    if plain > _LEAST_EXACT:
        return math.log(plain)
    # P = I_x(a, 1/2) / 2 with x = df / (df + t^2), through x^a (1-x)^b / (a B(a, b)) 2F1(a + b, 1; a + 1; x).
    a, b, ratio = df / 2, 0.5, statistic**2 / df
    x = 1 / (1 + ratio)
    head = -a * math.log1p(ratio) + b * math.log(ratio * x) - math.log(a) - float(special.betaln(a, b))
    return head + math.log(float(special.hyp2f1(a + b, 1.0, a + 1.0, x))) - math.log(2)


def log_normal_cdf(statistic: float) -> float:
    """Natural logarithm of the normal distribution function."""
    return float(special.log_ndtr(statistic))


def log_pvalue(log_lower: float, log_upper: float, alternative: Alternative) -> float:
    """The p-value's logarithm from those of both tails, each with the observed value included."""
    both = min(0.0, min(log_lower, log_upper) + math.log(2))
    return {"less": log_lower, "greater": log_upper, "two-sided": both}[alternative]


def log_t_pvalue(statistic: float, df: float, alternative: Alternative) -> float:
    """The logarithm of a t test's p-value."""
    return log_pvalue(log_t_cdf(statistic, df), log_t_cdf(-statistic, df), alternative)


def t_interval(
    mean: float, error: float, df: float, confidence: float, alternative: Alternative
) -> tuple[float, float]:
    """The shifts that a t test does not reject; infinite on the side of a one-sided claim."""
    if alternative == "two-sided":
        reach = float(special.stdtrit(df, (1 + confidence) / 2)) * error
        return mean - reach, mean + reach
    reach = float(special.stdtrit(df, confidence)) * error
    return (-math.inf, mean + reach) if alternative == "less" else (mean - reach, math.inf)


def log_normal_pvalue(statistic: float, alternative: Alternative) -> float:
    """The logarithm of a z test's p-value."""
    return log_pvalue(log_normal_cdf(statistic), log_normal_cdf(-statistic), alternative)


def holm(log_pvalues: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment, on logarithms; ``nan`` stays ``nan`` and counts as no test."""
    values = np.asarray(log_pvalues, dtype=float)
    adjusted = np.full(len(values), np.nan)
    order = [index for index in np.argsort(values, kind="stable") if not np.isnan(values[index])]
    highest = -np.inf
    for rank, index in enumerate(order):
        highest = max(highest, min(0.0, values[index] + math.log(len(order) - rank)))
        adjusted[index] = highest
    return adjusted.tolist()
