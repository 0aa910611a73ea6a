"""Ladders: how many rungs of a known distortion a figure puts in order, beside what it is said to see of it.

A rung is one step further from what was distorted. Of a cell's figures on all rungs, steps to the next rung are counted
that make the figure worse, better or leave it, and all pairs of rungs by Kendall's tau (a): 1 where the figure is worse
on every higher rung, -1 where it is better, and 0 where it does not move. A figure sees a distortion where the 95 %
interval of tau for new scenes and styles (:func:`anystyle_benchmark.statistics.interval`) leaves 0 out, and is blind to
it where the interval lies within :data:`BLIND` of 0; else the cells are too few to say.
"""

from collections.abc import Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from msgspec import Struct
from msgspec.structs import replace

from anystyle.evaluation.judge import mean
from anystyle.io.documents import Figure, as_figure, as_number, read_json, read_toml
from anystyle_benchmark.distortions import DISTORTIONS
from anystyle_benchmark.results import CellFigures, Figures, Interval, Lock, MetricInfo, SceneFigures
from anystyle_benchmark.spec import Spec
from anystyle_benchmark.statistics import arranged, interval, rounded

LADDER = "ladder.json"
STEPS = len(next(iter(DISTORTIONS.values())).strengths)
UNDISTORTED = "undistorted"
"""The name of the lowest rung of every ladder, as a method of a benchmark."""
MOST = 0.75
"""The share of steps of which a figure that orders a ladder in full has at least so many in order."""
BLIND = 0.5
"""The largest tau, either way, of a figure that is called blind: of ten pairs of rungs 7.5 are in one order."""
TIED = 1e-6  # relative: figures are rounded to seven digits

Effect = Literal["worse", "better", "blind"]
Values = Float[np.ndarray, "R *cells"]
"""A figure by rung, from the lowest, in every cell; ``nan`` where there is none."""


class Expected(Struct, frozen=True, forbid_unknown_fields=True):
    """What some figures are said to do as some distortions grow, and why; ``better`` is by the figure's own arrow."""

    figures: tuple[str, ...]
    distortions: tuple[str, ...]
    effect: Effect
    reason: str


class Verdict(Struct, frozen=True):
    """What a figure makes of a distortion.

    Args:
        expected: What it is said to do; ``None`` where nothing is claimed.
        found: What it does; ``None`` where there are too few scenes and styles to say.
        tau: Kendall's tau of rung and figure, above 0 where the figure gets worse.
        ordered: How many steps of :data:`STEPS` move as is expected, or to the worse where nothing or nothing else is.
        tied: Mean number of steps that leave the figure as it is.
        unknown: Mean number of steps of which an end has no figure.
        means: The figure's mean on each rung.
    """

    figure: str
    distortion: str
    expected: Effect | None
    found: Effect | None
    tau: Interval
    ordered: Interval
    tied: float
    unknown: float
    means: list[Figure]

    @property
    def kind(self) -> str:
        """The finding beside the expectation, one of :data:`WORDS`."""
        match self.expected, self.found:
            case _, None:
                return "undecided"
            case None, found:
                return f"unclaimed_{found}"
            case "blind", "blind":
                return "blind"
            case "blind", found:
                return f"unforeseen_{found}"
            case _, "blind":
                return "fails_blind"
            case expected, found if expected != found:
                return "fails_inverted"
            case "better", _:
                return "inverted"
        return "orders" if as_number(self.ordered.mean) >= MOST * STEPS else "orders_part"

    @property
    def fails(self) -> bool:
        """Whether it is blind to what it should see, or inverts it."""
        return self.kind.startswith("fails")


WORDS = {
    "orders": "orders",
    "orders_part": "orders in part",
    "inverted": "rewards it (by design)",
    "blind": "blind (by design)",
    "fails_blind": "blind (fails)",
    "fails_inverted": "inverted (fails)",
    "unforeseen_worse": "sees it (unforeseen)",
    "unforeseen_better": "rewards it (unforeseen)",
    "unclaimed_worse": "worse (no claim)",
    "unclaimed_better": "better (no claim)",
    "unclaimed_blind": "blind (no claim)",
    "undecided": "undecided",
}
"""Every kind of verdict in words."""


class Ladder(Struct, frozen=True):
    """How a track's figures order distortions of a method's results, in ``n`` scenes and styles.

    ``weights`` are SHA-256 of the files of each metric, ``metrics`` say which networks are stand-ins.
    """

    track: Lock
    method: Spec
    scenes: list[str]
    styles: list[str]
    views: int
    metrics: dict[str, MetricInfo]
    weights: dict[str, dict[str, str]]
    verdicts: list[Verdict]

    def of(self, figure: str) -> list[Verdict]:
        """The verdicts of a figure."""
        return [verdict for verdict in self.verdicts if verdict.figure == figure]

    @property
    def failing(self) -> list[str]:
        """The figures that do not see a distortion that they are said to see, or take it for the reverse."""
        return [figure for figure in self.metrics if any(verdict.fails for verdict in self.of(figure))]

    def failures(self, figure: str) -> str:
        """What a figure is blind to, inverts, or rewards, though it is said not to."""
        kinds = ("fails_blind", "blind to"), ("fails_inverted", "inverts"), ("unforeseen_better", "rewards")
        said = []
        for kind, words in kinds:
            if names := [title(one.distortion) for one in self.of(figure) if one.kind == kind]:
                said.append(f"{words} {', '.join(names)}")
        return "; ".join(said)

    def sentence(self, figure: str) -> str:
        """How many of the distortions that a figure is said to see it sees, and its failures."""
        should = [one for one in self.of(figure) if one.expected in ("worse", "better")]
        seen = sum(one.found == one.expected for one in should)
        unsure = sum(one.found is None for one in should)
        counted = [f"sees {seen} of {len(should)} that it should" + f", {unsure} undecided" * bool(unsure)] * bool(
            should
        )
        return "; ".join(filter(None, [*counted, self.failures(figure)]))


def title(distortion: str) -> str:
    """A distortion in words."""
    return DISTORTIONS[distortion].title


def rung(distortion: str, index: int) -> str:
    """The name of a rung as a method of a benchmark; the lowest is common to all distortions."""
    return f"{distortion}-{index}" if index else UNDISTORTED


@cache
def expectations() -> dict[tuple[str, str], Expected]:
    """What figures are said to see, by figure and distortion, as ``ladder.toml`` declares."""
    path = Path(__file__).with_name("ladder.toml")
    rows: dict[str, list[Expected]] = read_toml(path, dict[str, list[Expected]], what="table of expectations")
    found: dict[tuple[str, str], Expected] = {}
    for row in rows["expected"]:
        for place in ((figure, distortion) for figure in row.figures for distortion in row.distortions):
            if place in found or place[1] not in DISTORTIONS:
                raise ValueError(f"{path}: {' of '.join(place)} stands there twice, or names an unknown distortion")
            found[place] = row
    return found


def judged(figures: Figures, distortions: Sequence[str]) -> list[Verdict]:
    """The verdicts of all figures that have values on the rungs of these distortions, and are not all the same."""
    rows: dict[str, list[CellFigures | SceneFigures]] = {}
    for row in (*figures.cells, *figures.scenes):
        rows.setdefault(row.method, []).append(row)
    found: list[Verdict] = []
    for figure, info in figures.metrics.items():
        for distortion in distortions:
            ladder = [rows.get(rung(distortion, index), []) for index in range(STEPS + 1)]
            values = np.stack(arranged(figure, *ladder))
            if (~np.isnan(values[1:] - values[:-1])).any():
                found.append(verdict(figure, distortion, values if info.better == "lower" else -values, info.better))
    moving = {one.figure for one in found if one.tied + one.unknown < STEPS}
    return [one for one in found if one.figure in moving]


def verdict(figure: str, distortion: str, values: Values, better: str) -> Verdict:
    """The verdict on a figure's values, which grow as the figure gets worse."""
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
    sign = 1 if better == "lower" else -1
    means: list[Figure] = [as_figure(rounded(mean((sign * one).ravel().tolist()))) for one in values]
    tied, unknown = (steps == 0).sum(0)[known].mean(), np.isnan(steps).sum(0)[known].mean()
    counts = rounded(float(tied)), rounded(float(unknown))
    return Verdict(figure, distortion, effect, found, tau, interval(ordered), *counts, means)


def compared(first: Float[np.ndarray, "*cells"], second: Float[np.ndarray, "*cells"]) -> Float[np.ndarray, "*cells"]:
    """1 where the second is greater, -1 where it is less, 0 where all digits are equal, ``nan`` if one is unknown."""
    with np.errstate(invalid="ignore"):
        signs = np.sign(second - first)
    return np.where(np.isclose(first, second, rtol=TIED, atol=0), 0.0, signs)


def bundled(folder: Path, figures: Figures) -> Ladder | None:
    """The ladder beside a track's file, if it is of the track, the judge and the networks of these figures."""
    path = folder / LADDER
    ladder: Ladder | None = read_json(path, Ladder, what="ladder") if path.is_file() else None
    if ladder is None or ladder.track.digest != figures.track.digest:
        return None
    stand_ins = {name: info.stand_in for name, info in figures.metrics.items()}
    alike = {name: info for name, info in ladder.metrics.items() if stand_ins.get(name) == info.stand_in}
    verdicts = [verdict for verdict in ladder.verdicts if verdict.figure in alike]
    return replace(ladder, metrics=alike, verdicts=verdicts) if verdicts else None
