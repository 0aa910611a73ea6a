"""Standardised effects of all answers, linearised and then averaged like them; and how far participants agree."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from anystyle.study.contract import Alternative, Responses
from anystyle.study.crossed import CrossedMean, Crossing
from anystyle.study.probability import t_interval


@dataclass(frozen=True)
class Effect:
    """An effect over all answers.

    Args:
        name: ``cohens_d`` or ``probability_of_superiority``.
        estimate: Negative prefers ours; of the probability, above 1/2 does.
        interval: At the study's confidence; ``nan`` where nothing varies.
    """

    name: str
    estimate: float
    interval: tuple[float, float]


def probability_interval(
    crossed: CrossedMean, column: int, confidence: float, alternative: Alternative
) -> tuple[float, float]:
    """The interval of a probability that is above 1/2 where ours is preferred; ``nan`` where nothing varies."""
    if crossed.error[column] == 0:
        return math.nan, math.nan
    sides: dict[Alternative, Alternative] = {"less": "greater", "greater": "less", "two-sided": "two-sided"}
    mean, error, df = (float(values[column]) for values in (crossed.mean, crossed.error, crossed.df))
    low, high = t_interval(mean, error, df, confidence, sides[alternative])
    return max(low, 0.0), min(high, 1.0)


def effects(responses: Responses, confidence: float = 0.95, alternative: Alternative = "two-sided") -> list[Effect]:
    """Cohen's d and the probability of superiority over all answers."""
    values, factors, name = responses.deviations, responses.factors, "probability_of_superiority"
    preferring = (1 - np.sign(values)) / 2
    mean, sd = float(values.mean()), float(values.std(ddof=1)) if responses.count > 1 else 0.0
    if not factors or sd <= 1e-14:
        return [Effect(name, float(preferring.mean()), (math.nan, math.nan))]
    # The influence of each answer on mean / SD.
    standard = (values - mean) / sd
    influence = standard - mean / sd * (standard**2 - 1) / 2
    crossed = Crossing(factors=factors).mean(np.stack([influence, preferring], axis=1))
    error, df = float(crossed.error[0]), float(crossed.df[0])
    interval = t_interval(mean / sd, error, df, confidence, alternative) if error > 0 else (math.nan, math.nan)
    return [
        Effect("cohens_d", mean / sd, interval),
        Effect(name, float(preferring.mean()), probability_interval(crossed, 1, confidence, alternative)),
    ]


def krippendorff_alpha(counts: Float[np.ndarray, "J K"]) -> float:
    """Krippendorff's alpha with the ordinal metric.

    Args:
        counts: How often each item (row) received each answer, answers in ascending order.

    Returns:
        1 where all agree, 0 where they agree as by chance, ``nan`` where nothing can be compared.
    """
    compared = counts[counts.sum(1) >= 2]
    sizes = compared.sum(1)
    # Each item's pairs of answers, weighted so that an answer counts once however many others there are.
    coincidences = (compared / (sizes - 1)[:, None]).T @ compared - np.diag((compared / (sizes - 1)[:, None]).sum(0))
    totals = compared.sum(0)
    total = totals.sum()
    cumulative = np.cumsum(totals) - totals / 2
    distance = (cumulative[:, None] - cumulative[None, :]) ** 2
    expected = (totals[:, None] * totals[None, :] * distance).sum()
    if expected <= 0:
        return math.nan
    return float(1 - (total - 1) * (coincidences * distance).sum() / expected)


def agreement(responses: Responses) -> float:
    """Krippendorff's ordinal alpha over items."""
    levels, level = np.unique(responses.deviations, return_inverse=True)
    items, item = np.unique(responses.items, return_inverse=True)
    flat = np.bincount(item * len(levels) + level, minlength=len(items) * len(levels))
    return krippendorff_alpha(flat.reshape(len(items), len(levels)).astype(float))
