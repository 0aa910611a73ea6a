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
from anystyle.io.documents import as_number
from anystyle_benchmark.command_compare import STUDIED
from anystyle_benchmark.people import correlation
from anystyle_study.balance import balanced_subsets, draw_pairs
from anystyle_study.commands import read_plan
from tests.support.people_cases import simulated

STUDIES, STYLES = 200, 12
ROWS = [(0.3, 4, n) for n in (6, 12, 24, 48)] + [(1.0, 4, n) for n in (6, 12, 24, 48)] + [(1.0, 8, 24)]
"""SD of scenes, number of scenes, participants."""


def bundled(participants: int, scenes: int) -> np.ndarray:
    """The sets of each participant (P, N, 4) as ``study=benchmark`` draws them: scene, style, and two methods."""
    plan, generator = read_plan(["study=benchmark"]), np.random.default_rng(0)
    pairs = np.array([*combinations(range(len(STUDIED)), 2)])
    pool = np.array(draw_pairs(np.ones((scenes, STYLES, len(pairs)), dtype=bool), plan.pool, generator))
    subsets = balanced_subsets(pool, plan.sets, participants // 2, generator)
    sets = pool[np.repeat(subsets, 2, axis=0)]
    return np.concatenate([sets[..., :2], pairs[sets[..., 2]]], axis=-1)


def rejected(design: np.ndarray, d: float, shared: float) -> tuple[float, float]:
    """How often D = 0 is rejected at the level 0.05, and at 0.05 / 20, where it is ``d``."""
    gap = 2 * (1 + shared**2)
    noise = math.sqrt(gap / (gap + 1.5) / math.sin(math.pi * d / 2) ** 2 - 1) if d else math.inf
    pvalues = []
    for seed in range(STUDIES):
        choices, order, _ = simulated(design, noise, seed, shared=shared)
        pvalues.append(as_number(correlation("style", "score", choices, order).pvalue))
    return float(np.mean(np.array(pvalues) <= 0.05)), float(np.mean(np.array(pvalues) <= 0.05 / 20))


def main() -> None:
    """Print the table."""
    rows = []
    for shared, scenes, participants in ROWS:
        design = bundled(participants, scenes)
        (false, _), *found = (rejected(design, d, shared) for d in (0.0, 0.3, 0.5))
        numbers = (f"{value:.2f}" for value in (false, *(value for pair in found for value in pair)))
        rows.append((f"{shared:g}", str(scenes), str(participants), *numbers))
    powers = (f"D = {d}{of}" for d in (0.3, 0.5) for of in ("", ", first of 20"))
    sys.stdout.write(Table(("SD of scenes", "scenes", "participants", "D = 0", *powers), tuple(rows)).markdown())


if __name__ == "__main__":
    main()
