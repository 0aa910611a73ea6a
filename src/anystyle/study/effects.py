"""Standardised effects of all answers, for new participants and items: linearised, then averaged like the answers."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from anystyle.study.contract import Alternative, Responses
from anystyle.study.crossed import Crossing
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


def cohens_d_interval(statistic: float, n: int, confidence: float, alternative: Alternative) -> tuple[float, float]:
    """Cohen's d whose noncentral t distribution has the observed statistic at either tail.

    Where that distribution leaves the range of its algorithm, the large-sample interval takes its place.
    """
    tail = (1 - confidence) / (2 if alternative == "two-sided" else 1)
    low = float(special.nctdtrinc(n - 1, 1 - tail, statistic)) / math.sqrt(n)
    high = float(special.nctdtrinc(n - 1, tail, statistic)) / math.sqrt(n)
    effect = statistic / math.sqrt(n)
    if not (np.isfinite([low, high]).all() and low < effect < high and abs(statistic) < 30):
        half_width = float(special.ndtri(1 - tail)) * math.sqrt(1 / n + effect**2 / (2 * n))
        low, high = effect - half_width, effect + half_width
    return (-math.inf if alternative == "less" else low), (math.inf if alternative == "greater" else high)


def effects(responses: Responses, confidence: float = 0.95, alternative: Alternative = "two-sided") -> list[Effect]:
    """Cohen's d and the probability of superiority over all answers."""
    values, factors = responses.deviations, responses.factors
    mean, sd = float(values.mean()), float(values.std(ddof=1)) if responses.count > 1 else 0.0
    preferring = (1 - np.sign(values)) / 2
    estimates = {"probability_of_superiority": (float(preferring.mean()), preferring)}
    if sd > 1e-14:
        # The influence of each answer on mean / SD.
        standard = (values - mean) / sd
        estimates = {"cohens_d": (mean / sd, standard - mean / sd * (standard**2 - 1) / 2), **estimates}
    results: list[Effect] = []
    flipped: Alternative = {"less": "greater", "greater": "less"}.get(alternative, "two-sided")  # type: ignore[assignment]
    for name, (estimate, influence) in estimates.items():
        interval = (math.nan, math.nan)
        crossed = Crossing(factors=factors).mean(influence) if factors else None
        if crossed is not None and crossed.error > 0:
            sides = alternative if name == "cohens_d" else flipped
            interval = t_interval(estimate, float(crossed.error), float(crossed.df), confidence, sides)
        if name == "probability_of_superiority":
            interval = max(interval[0], 0.0), min(interval[1], 1.0)
        results.append(Effect(name, estimate, interval))
    return results
