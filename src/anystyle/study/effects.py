"""Standardised effects of all answers, with intervals that respect participants and items."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy import special

from anystyle.study.bootstrap import bootstrap_counts
from anystyle.study.contract import Responses


@dataclass(frozen=True)
class Effect:
    """An effect over all answers.

    Args:
        name: ``cohens_d``, ``rank_biserial`` or ``probability_of_superiority``.
        estimate: Negative prefers ours; of the probability, above 1/2 does.
        interval: From resampling participants and items; conservative, since both margins are resampled.
        confidence: Of the interval.
    """

    name: str
    estimate: float
    interval: tuple[float, float]
    confidence: float


def cohens_d_interval(statistic: float, n: int, confidence: float) -> tuple[float, float]:
    """Cohen's d whose noncentral t distribution has the observed statistic at either tail.

    Where that distribution leaves the range of its algorithm, the large-sample interval takes its place.
    """
    tail = (1 - confidence) / 2
    low = float(special.nctdtrinc(n - 1, 1 - tail, statistic)) / math.sqrt(n)
    high = float(special.nctdtrinc(n - 1, tail, statistic)) / math.sqrt(n)
    effect = statistic / math.sqrt(n)
    if np.isfinite([low, high]).all() and low < effect < high and abs(statistic) < 30:
        return low, high
    half_width = float(special.ndtri(1 - tail)) * math.sqrt(1 / n + effect**2 / (2 * n))
    return effect - half_width, effect + half_width


def from_counts(
    levels: Float[np.ndarray, " K"], counts: Float[np.ndarray, "R K"]
) -> dict[str, Float[np.ndarray, " R"]]:
    """Every effect from how often each deviation occurs, for each row of counts; ``nan`` where nothing varies."""
    total = counts.sum(1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = counts @ levels / total
        variance = (counts @ levels**2 - total * mean**2) / (total - 1)
        cohens_d = mean / np.sqrt(np.where(variance > 1e-14, variance, np.nan))
        superiority = (counts[:, levels < 0].sum(1) + counts[:, levels == 0].sum(1) / 2) / total
        sizes = np.unique(np.abs(levels[levels != 0]))
        sides = [counts @ (levels == sign * sizes[:, None]).T for sign in (1, -1)]  # R sizes
        tied = sides[0] + sides[1]
        ranks = np.cumsum(tied, axis=1) - (tied - 1) / 2
        plus, minus = ((side * ranks).sum(1) for side in sides)
        rank_biserial = (plus - minus) / (plus + minus)
    return {"cohens_d": cohens_d, "rank_biserial": rank_biserial, "probability_of_superiority": superiority}


def effects(responses: Responses, *, resamples: int = 1999, seed: int = 0, confidence: float = 0.95) -> list[Effect]:
    """Cohen's d, the rank-biserial correlation and the probability of superiority over all answers."""
    levels, counts = np.unique(responses.deviations, return_counts=True)
    estimates = from_counts(levels, counts[None].astype(float))
    resampled = from_counts(levels, bootstrap_counts(responses, levels, resamples=resamples, seed=seed))
    results: list[Effect] = []
    for name, estimate in estimates.items():
        usable = resampled[name][np.isfinite(resampled[name])]
        interval = (math.nan, math.nan)
        if len(usable) > resamples // 2:
            low, high = np.quantile(usable, [(1 - confidence) / 2, (1 + confidence) / 2])
            interval = (float(low), float(high))
        results.append(Effect(name, float(estimate[0]), interval, confidence))
    return results
