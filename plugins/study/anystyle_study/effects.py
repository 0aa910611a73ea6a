"""Standardised effects over all answers, with intervals over crossed factors, and agreement between participants."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from anystyle_study.contract import Alternative, Responses
from anystyle_study.crossed import Crossing
from anystyle_study.probability import t_interval


@dataclass(frozen=True)
class Effect:
    """An effect over all answers."""

    name: str  # ``cohens_d`` or ``probability_of_superiority``
    estimate: float  # negative prefers ours; a probability above 1/2 does
    interval: tuple[float, float]  # confidence interval; ``nan`` if nothing varies


def superiority(responses: Responses, confidence: float = 0.95, alternative: Alternative = "two-sided") -> Effect:
    """Probability that an answer prefers ours, ties counted half."""
    preferring = (1 - np.sign(responses.deviations)) / 2
    interval = math.nan, math.nan
    if responses.factors:
        sides: dict[Alternative, Alternative] = {"less": "greater", "greater": "less", "two-sided": "two-sided"}
        crossed = Crossing(factors=responses.factors).mean(preferring)
        low, high = crossed.interval(confidence, sides[alternative])
        interval = (low, high) if math.isnan(low) else (max(low, 0.0), min(high, 1.0))
    return Effect("probability_of_superiority", float(preferring.mean()), interval)


def effects(responses: Responses, confidence: float = 0.95, alternative: Alternative = "two-sided") -> list[Effect]:
    """Cohen's d (where answers vary) and the probability of superiority over all answers."""
    values, factors = responses.deviations, responses.factors
    probability = superiority(responses, confidence, alternative)
    mean, sd = float(values.mean()), float(values.std(ddof=1)) if responses.count > 1 else 0.0
    if not factors or sd <= 1e-14:
        return [probability]
    # The influence of each answer on mean / SD (the delta method).
    standard = (values - mean) / sd
    crossed = Crossing(factors=factors).mean(standard - mean / sd * (standard**2 - 1) / 2)
    interval = t_interval(mean / sd, float(crossed.error), float(crossed.df), confidence, alternative)
    return [Effect("cohens_d", mean / sd, interval), probability]


def krippendorff_alpha(counts: Float[np.ndarray, "J K"]) -> float:
    """Krippendorff's ordinal alpha of each item's (row's) counts of the answers; ``nan`` if nothing can be compared."""
    compared = counts[counts.sum(1) >= 2]
    # Each item's pairs of answers, weighted so that every answer counts once.
    weighted = compared / (compared.sum(1) - 1)[:, None]
    coincidences = weighted.T @ compared - np.diag(weighted.sum(0))
    totals = compared.sum(0)
    cumulative = np.cumsum(totals) - totals / 2
    distance = (cumulative[:, None] - cumulative[None, :]) ** 2
    expected = (totals[:, None] * totals[None, :] * distance).sum()
    return float(1 - (totals.sum() - 1) * (coincidences * distance).sum() / expected) if expected > 0 else math.nan


def agreement(responses: Responses) -> float:
    """Krippendorff's ordinal alpha over items."""
    levels, level = np.unique(responses.deviations, return_inverse=True)
    items, item = np.unique(responses.items, return_inverse=True)
    counts = np.bincount(item * len(levels) + level, minlength=len(items) * len(levels))
    return krippendorff_alpha(counts.reshape(len(items), len(levels)))
