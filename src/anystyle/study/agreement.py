"""How far participants agree: Krippendorff's alpha for ordinal answers."""

import math

import numpy as np
from jaxtyping import Float

from anystyle.study.contract import Responses


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


def agreement(
    responses: Responses, *, resamples: int = 999, seed: int = 0, confidence: float = 0.95
) -> tuple[float, tuple[float, float]]:
    """Krippendorff's ordinal alpha over items, and an interval from resampling the items."""
    levels, level = np.unique(responses.deviations, return_inverse=True)
    items, item = np.unique(responses.items, return_inverse=True)
    flat = np.bincount(item * len(levels) + level, minlength=len(items) * len(levels))
    counts = flat.reshape(len(items), len(levels)).astype(float)
    alpha = krippendorff_alpha(counts)
    if math.isnan(alpha) or len(items) < 2:
        return alpha, (math.nan, math.nan)
    generator = np.random.default_rng(seed)
    drawn = generator.integers(0, len(items), (resamples, len(items)))
    values = np.array([krippendorff_alpha(counts[rows]) for rows in drawn])
    low, high = np.nanquantile(values, [(1 - confidence) / 2, (1 + confidence) / 2])
    return alpha, (float(low), float(high))
