"""How many participants tell a score that follows people from one that does not, on the design ``study=benchmark``.

``python -m tests.benchmarks.people`` simulates studies of six methods on the track ``open`` and prints how often the
test of Somers' D rejects 0, by participants: for scores of D = 0 (false positives) and 0.3, at the level of one score
and at that of the first of twenty by Holm's method. See :func:`tests.support.people_cases.simulated`.
"""

import math
import sys
from itertools import combinations

import numpy as np

from anystyle.evaluation.tables import Table
from anystyle_benchmark.command_compare import STUDIED
from anystyle_benchmark.people import correlation
from anystyle_study.balance import balanced_subsets, draw_pairs
from anystyle_study.commands import read_plan
from tests.support.people_cases import simulated

STUDIES, SCENES, STYLES, D = 200, 4, 12, 0.3


def bundled(participants: int) -> np.ndarray:
    """The sets of each participant (P, N, 4) as ``study=benchmark`` draws them: scene, style, and two methods."""
    plan, generator = read_plan(["study=benchmark"]), np.random.default_rng(0)
    pairs = np.array([*combinations(range(len(STUDIED)), 2)])
    pool = np.array(draw_pairs(np.ones((SCENES, STYLES, len(pairs)), dtype=bool), plan.pool, generator))
    subsets = balanced_subsets(pool, plan.sets, participants // 2, generator)
    sets = pool[np.repeat(subsets, 2, axis=0)]
    return np.concatenate([sets[..., :2], pairs[sets[..., 2]]], axis=-1)


def rejected(participants: int, noise: float, shared: float) -> list[float]:
    """How often 0 is left out at the level 0.05, and at 0.05 / 20; and half the interval, as a mean."""
    design = bundled(participants)
    found = []
    for seed in range(STUDIES):
        choices, order, _ = simulated(design, noise, seed, shared=shared)
        one = correlation("style", "score", choices, order)
        found.append((one.pvalue <= 0.05, one.pvalue <= 0.05 / 20, (one.high - one.low) / 2))
    return np.mean(found, axis=0).tolist()


def main() -> None:
    """Print the table."""
    rows = []
    for shared in (0.3, 1.0):
        gap = 2 * (1 + shared**2)
        noise = math.sqrt(gap / (gap + 1.5) / math.sin(math.pi * D / 2) ** 2 - 1)
        for participants in (6, 12, 24, 36, 60):
            false, _, _ = rejected(participants, math.inf, shared)
            found, holm, half = rejected(participants, noise, shared)
            numbers = (f"{value:.2f}" for value in (false, found, holm, half))
            rows.append((f"{shared:g}", str(participants), *numbers))
    columns = ("SD of scenes", "participants", "D = 0", f"D = {D}", f"D = {D}, first of 20", "half the interval")
    sys.stdout.write(Table(columns, tuple(rows)).markdown())


if __name__ == "__main__":
    main()
