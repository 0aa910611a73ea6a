"""Means over scenes and styles, with intervals for new scenes and styles, and differences of two methods.

Scenes and styles are crossed random factors. The error of a mean comes from the pigeonhole bootstrap (Owen, Annals of
Applied Statistics 2007), which draws scenes and styles anew, each on its own. Intervals are Student's on
Satterthwaite's degrees of freedom: percentiles never leave what the few scenes at hand have, and cover too little.
Differences are tested by the closed form of the same model (:class:`anystyle_study.statistics.Crossing`), which needs
no seed; the bootstrap counts what only one scene and style share up to three times, which costs power.
"""

import math
from collections.abc import Sequence
from itertools import product
from statistics import fmean
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from anystyle.evaluation.judge import mean
from anystyle.io.documents import as_number, stored_number
from anystyle_benchmark.results import CellFigures, Interval, SceneFigures
from anystyle_study.statistics import CrossedMean, Crossing, t_interval, t_pvalue

DRAWS, CONFIDENCE = 2000, 0.95
EPSILON = 1e-7  # relative precision of a figure, of 32 bits
Values = Float[np.ndarray, "S *T"]
"""A figure by scene, and by style if it has one for each; ``nan`` where there is none."""


class Difference(NamedTuple):
    """A mean difference with its 95 % interval and the two-sided p-value; ``nan`` where too little is known."""

    mean: float
    low: float
    high: float
    pvalue: float
    n: int


def arranged(figure: str, *groups: Sequence[CellFigures | SceneFigures]) -> list[Values]:
    """The figure in each group of rows by scene and style, means over seeds; all of one shape."""
    found: list[dict[tuple[str, ...], list[float]]] = [{} for _ in groups]
    for places, rows in zip(found, groups, strict=True):
        for row in rows:
            if figure in row.figures:
                places.setdefault(row.place, []).append(as_number(row.figures[figure]))
    axes = [sorted(set(levels)) for levels in zip(*{place for places in found for place in places}, strict=True)]
    shape = [len(axis) for axis in axes] or [0]
    means = ([mean(places.get(place, [])) for place in product(*axes)] if axes else [] for places in found)
    return [np.reshape(values, shape) for values in means]


def pigeonhole(values: Values, *, draws: int = DRAWS, seed: int = 0) -> Float[np.ndarray, " draws"]:
    """Means over scenes, and styles, drawn anew; ``nan`` where nothing known was drawn.

    Of each factor one level fewer than there are is drawn, which makes the variance unbiased (Rao and Wu, JASA 1988).
    """
    generator = np.random.default_rng(seed)
    values = values[np.ix_(*(np.unique(place) for place in np.nonzero(np.isfinite(values))))]
    times = [generator.multinomial(n - 1, np.full(n, 1 / n), draws) for n in values.shape]
    known = np.isfinite(values)
    products = [
        np.einsum("bs,s->b" if values.ndim == 1 else "bs,bt,st->b", *times, table, optimize=True)
        for table in (np.where(known, values, 0.0), known.astype(float))
    ]
    with np.errstate(invalid="ignore"):
        return products[0] / products[1]


def interval(values: Values) -> Interval:
    """The mean over all known cells; no bounds where a factor has one level, or a value is infinite."""
    mean, crossed, count = _crossed(values)
    low = high = math.nan
    if crossed is not None and crossed.error > 0:
        low, high = t_interval(mean, float(np.nanstd(pigeonhole(values))), float(crossed.df), CONFIDENCE)
    elif crossed is not None:
        low = high = mean  # nothing varies
    return Interval(stored_number(rounded(mean)), stored_number(rounded(low)), stored_number(rounded(high)), count)


def difference(first: Values, second: Values) -> Difference:
    """The mean of ``first - second`` over the cells that both have."""
    with np.errstate(invalid="ignore"):
        # inf - inf is nan: two perfect figures say nothing of how far they are apart
        mean, crossed, count = _crossed(first - second)
    if crossed is None:
        return Difference(mean, math.nan, math.nan, math.nan, count)
    if crossed.error <= EPSILON * abs(mean):  # the same difference everywhere: no error is known, and there is no test
        return Difference(mean, mean, mean, math.nan, count)
    pvalue = t_pvalue(mean / float(crossed.error), float(crossed.df), "two-sided")
    return Difference(mean, *crossed.interval(CONFIDENCE), pvalue, count)


def rounded(value: float) -> float:
    """A figure to seven digits, all that its 32 bits hold: the same whatever order its sums were taken in."""
    return float(f"{value:.7g}")


def _crossed(values: Values) -> tuple[float, CrossedMean | None, int]:
    """The mean, its model where every factor has two levels and all that is known is finite, and how many are known."""
    places = np.nonzero(~np.isnan(values))
    known = values[places]
    mean = float(known.mean()) if len(known) else math.nan
    levels = [np.unique(place, return_inverse=True)[1] for place in places]
    if not np.isfinite(known).all() or min((int(level.max()) for level in levels if len(level)), default=0) < 1:
        return mean, None, len(known)
    return mean, Crossing(factors=dict(zip(("scenes", "styles"), levels, strict=False))).mean(known), len(known)


def cost(cells: Sequence[CellFigures]) -> float | None:
    """Mean CPU seconds of a further style."""
    seconds = [cell.seconds for cell in cells if cell.seconds is not None]
    return fmean(seconds) if seconds else None
