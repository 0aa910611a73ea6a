"""p-values as logarithms, so that none underflows, Holm's adjustment, and t intervals."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from anystyle_study.contract import Alternative


def log_t_cdf(statistic: float, df: float) -> float:
    """Natural logarithm of Student's t distribution function, exact far into the lower tail."""
    if math.isinf(df):
        return float(special.log_ndtr(statistic))
    plain = float(special.stdtr(df, statistic))
    if plain > 1e-280:  # below, it may have lost digits or be 0
        return math.log(plain)
    # P = I_x(a, 1/2) / 2 with x = df / (df + t^2), through x^a (1-x)^b / (a B(a, b)) 2F1(a + b, 1; a + 1; x).
    a, b, ratio = df / 2, 0.5, statistic**2 / df
    x = 1 / (1 + ratio)
    head = -a * math.log1p(ratio) + b * math.log(ratio * x) - math.log(a) - float(special.betaln(a, b))
    return head + math.log(float(special.hyp2f1(a + b, 1.0, a + 1.0, x))) - math.log(2)


def log_t_pvalue(statistic: float, df: float, alternative: Alternative) -> float:
    """Logarithm of the p-value of a t test, or of a z test with infinite degrees of freedom."""
    lower, upper = log_t_cdf(statistic, df), log_t_cdf(-statistic, df)
    return {"less": lower, "greater": upper, "two-sided": min(0.0, min(lower, upper) + math.log(2))}[alternative]


def t_interval(
    mean: float, error: float, df: float, confidence: float, alternative: Alternative = "two-sided"
) -> tuple[float, float]:
    """Confidence interval of a mean, infinite on one side for a one-sided alternative; ``nan`` without an error."""
    if not error > 0:
        return math.nan, math.nan
    half_width = float(special.stdtrit(df, (1 + confidence) / 2 if alternative == "two-sided" else confidence)) * error
    low = -math.inf if alternative == "less" else mean - half_width
    return low, math.inf if alternative == "greater" else mean + half_width


def holm(log_pvalues: Sequence[float]) -> list[float]:
    """Holm's step-down adjustment, on logarithms; ``nan`` stays ``nan`` and counts as no test."""
    values = np.asarray(log_pvalues, dtype=float)
    order = np.argsort(values, kind="stable")[: int((~np.isnan(values)).sum())]
    steps = np.log(np.arange(len(order), 0, -1))
    adjusted = np.full(len(values), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(values[order] + steps), 0.0)
    return adjusted.tolist()
