"""Ladders: how many rungs of a known distortion a score puts in order, beside what it should see of it.

A rung is one step further from what was distorted. Of a cell's scores on all rungs, steps to the next rung are counted
that make the score worse, better or leave it, and all pairs of rungs by Kendall's tau (a): 1 where the score is worse
on every higher rung, -1 where it is better, and 0 where it does not move. A score sees a distortion where the 95 %
interval of tau for new scenes and styles (:func:`anystyle_benchmark.statistics.interval`) leaves 0 out, and is blind to
it where the interval lies within :data:`BLIND` of 0; else the cells are too few to say.
"""

from collections.abc import Sequence
from functools import cache
from itertools import combinations, product
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from msgspec import Struct

from anystyle.io.documents import as_number, read_toml
from anystyle_benchmark.distortions import DISTORTIONS
from anystyle_benchmark.results import CellFigures, Figures, Interval, SceneFigures
from anystyle_benchmark.statistics import arranged, interval

LADDER = "ladder.json"
STEPS = len(next(iter(DISTORTIONS.values())).strengths)
UNDISTORTED = "undistorted"
"""The name of the lowest rung of every ladder, as a method of a benchmark."""
MOST = 0.75
"""The least share of steps in order of a score that orders a ladder in full."""
BLIND = 0.5
"""The largest tau, either way, of a score that is called blind: of ten pairs of rungs 7.5 are in one order."""
TIED = 1e-6  # relative: scores are rounded to seven digits

Effect = Literal["worse", "better", "blind"]
Values = Float[np.ndarray, "R *cells"]
"""A score by rung, from the lowest, in every cell; ``nan`` where there is none."""


class Expected(Struct, frozen=True, forbid_unknown_fields=True):
    """What some scores should do as some distortions grow, and why; ``better`` is by the score's own arrow."""

    figures: tuple[str, ...]
    distortions: tuple[str, ...]
    effect: Effect
    reason: str


class Verdict(Struct, frozen=True):
    """What a score makes of a distortion.

    Args:
        expected: What it should do; ``None`` where nothing is claimed.
        found: What it does; ``None`` where there are too few scenes and styles to say.
        tau: Kendall's tau of rung and score, above 0 where the score gets worse.
        ordered: How many steps of :data:`STEPS` move as is expected, or to the worse where nothing or nothing else is.
    """

    figure: str
    distortion: str
    expected: Effect | None
    found: Effect | None
    tau: Interval
    ordered: Interval

    @property
    def words(self) -> str:
        """The finding beside the expectation."""
        match self.expected, self.found:
            case _, None:
                return "undecided"
            case None, found:
                return f"{found} (no claim)"
            case "blind", "blind":
                return "blind (by design)"
            case "blind", found:
                return "sees it (unforeseen)" if found == "worse" else "rewards it (unforeseen)"
            case _, "blind":
                return "blind (fails)"
            case expected, found if expected != found:
                return "inverted (fails)"
            case "better", _:
                return "rewards it (by design)"
        return "orders" if as_number(self.ordered.mean) >= MOST * STEPS else "orders in part"


def rung(distortion: str, index: int) -> str:
    """The name of a rung as a method of a benchmark; the lowest is common to all distortions."""
    return f"{distortion}-{index}" if index else UNDISTORTED


@cache
def expectations() -> dict[tuple[str, str], Expected]:
    """What scores should see, by score and distortion, as ``ladder.toml`` declares."""
    path = Path(__file__).with_name("ladder.toml")
    rows: dict[str, list[Expected]] = read_toml(path, dict[str, list[Expected]], what="table of expectations")
    return {place: row for row in rows["expected"] for place in product(row.figures, row.distortions)}


def judged(figures: Figures, distortions: Sequence[str]) -> list[Verdict]:
    """The verdicts of all scores that have values on the rungs of these distortions, and are not all the same."""
    rows: dict[str, list[CellFigures | SceneFigures]] = {}
    for row in (*figures.cells, *figures.scenes):
        rows.setdefault(row.method, []).append(row)
    found: list[Verdict] = []
    for figure, info in figures.metrics.items():
        for distortion in distortions:
            ladder = [rows.get(rung(distortion, index), []) for index in range(STEPS + 1)]
            values = np.stack(arranged(figure, *ladder))
            if (~np.isnan(values[1:] - values[:-1])).any():
                found.append(verdict(figure, distortion, values if info.better == "lower" else -values))
    moving = {one.figure for one in found if (one.tau.low, one.tau.high) != (0, 0)}
    return [one for one in found if one.figure in moving]


def verdict(figure: str, distortion: str, values: Values) -> Verdict:
    """The verdict on a score's values, which grow as the score gets worse."""
    expected = expectations().get((figure, distortion))
    effect = None if expected is None else expected.effect
    steps = np.stack([compared(values[i], values[i + 1]) for i in range(len(values) - 1)])
    pairs = np.stack([compared(values[i], values[j]) for i, j in combinations(range(len(values)), 2)])
    known = ~np.isnan(steps).all(0)
    ordered = np.where(known, (steps == (-1 if effect == "better" else 1)).sum(0), np.nan)
    with np.errstate(invalid="ignore"):
        tau = interval(np.nansum(pairs, 0) / np.isfinite(pairs).sum(0))
    low, high = as_number(tau.low), as_number(tau.high)
    found: Effect | None = "worse" if low > 0 else "better" if high < 0 else "blind" if -low < BLIND > high else None
    return Verdict(figure, distortion, effect, found, tau, interval(ordered))


def compared(first: Float[np.ndarray, "*cells"], second: Float[np.ndarray, "*cells"]) -> Float[np.ndarray, "*cells"]:
    """1 where the second is greater, -1 where it is less, 0 where all digits are equal, ``nan`` if one is unknown."""
    with np.errstate(invalid="ignore"):
        signs = np.sign(second - first)
    return np.where(np.isclose(first, second, rtol=TIED, atol=0), 0.0, signs)
