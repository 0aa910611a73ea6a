"""Where answers vary, and what it costs to count every answer as independent."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from anystyle.study.contract import Responses


@dataclass(frozen=True)
class Variation:
    """Variance components of one question's answers, by the method of moments.

    Args:
        participant_sd: Between participants' true means.
        item_sd: Between items' true means.
        residual_sd: Of single answers besides.
        design_effect: How much larger the variance of the mean is than that of as many independent answers.
        effective_answers: As how many independent answers the study counts.
        naive_error_rate: How often a one-sided response-level test at 5 % would reject without any preference,
            by the normal approximation, in a study that varies as this one does.
    """

    participant_sd: float
    item_sd: float
    residual_sd: float
    design_effect: float
    effective_answers: float
    naive_error_rate: float


def variation(responses: Responses) -> Variation | None:
    """Split the variance; ``None`` where there is none, or one participant and one item only.

    Exact moments of a complete table; in an incomplete one, answers of a participant count as many as there are.
    """
    values = responses.deviations - responses.deviations.mean()
    n = len(values)
    groups = [np.unique(codes, return_inverse=True)[1] for codes in (responses.participants, responses.items)]
    sums = [np.bincount(group, values) for group in groups]
    counts = [np.bincount(group) for group in groups]
    sizes = [len(count) for count in counts]
    naive = float(values @ values) / (n - 1) / n if n > 1 else 0.0
    if naive <= 1e-24 or max(sizes) < 2:
        return None
    explained = [float((s**2 / c).sum()) for s, c in zip(sums, counts, strict=True)]
    freedom = n - 1 - sum(size - 1 for size in sizes)
    residual = max(float(values @ values) - sum(explained), 0.0) / freedom if freedom > 0 else 0.0
    components, parts = [], []
    for s, c, size in zip(sums, counts, sizes, strict=True):
        part = float(s @ s) / n**2 * size / (size - 1) if size > 1 else residual / n
        parts.append(part)
        components.append(max(part - residual / n, 0.0) * n**2 / float(c @ c) if size > 1 else 0.0)
    variance = max(parts[0] + parts[1] - residual / n, residual / n)
    design_effect = variance / naive
    return Variation(
        participant_sd=math.sqrt(components[0]),
        item_sd=math.sqrt(components[1]),
        residual_sd=math.sqrt(residual),
        design_effect=design_effect,
        effective_answers=n / design_effect,
        naive_error_rate=float(special.ndtr(special.ndtri(0.05) / math.sqrt(design_effect))),
    )
