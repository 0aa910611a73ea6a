"""Means over scenes and styles, with intervals for new scenes and styles, and differences of two methods.

Scenes and styles are crossed random factors: a few of each were chosen, and a claim is about others. The error of a
mean comes from the pigeonhole bootstrap (Owen, Annals of Applied Statistics 2007), which draws scenes and styles anew,
each on its own, and keeps every cell whose scene and style were drawn as often as both were. An interval is Student's
on Satterthwaite's degrees of freedom: percentiles never leave what the few scenes at hand have, and cover too little.

Differences of two methods in the same cells are tested by the closed form of the same model
(:class:`anystyle_study.statistics.Crossing`): it needs no seed, and the bootstrap counts what scene and style share
alone up to three times, which costs power.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from anystyle.evaluation.judge import mean
from anystyle.io.documents import as_figure, as_number
from anystyle_benchmark.results import CellFigures, Interval, SceneFigures
from anystyle_study.statistics import CrossedMean, Crossing, t_interval, t_pvalue

DRAWS, CONFIDENCE = 2000, 0.95
EPSILON = 1e-7
"""Relative precision of a figure, of 32 bits."""
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
    tables = [np.full([len(axis) for axis in axes] or [0], np.nan) for _ in groups]
    for table, places in zip(tables, found, strict=True):
        for place, values in places.items():
            table[tuple(axis.index(level) for axis, level in zip(axes, place, strict=True))] = mean(values)
    return tables


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
    mean, crossed = _crossed(values)
    low = high = math.nan
    if crossed is not None and crossed.error > 0:
        low, high = t_interval(mean, float(np.nanstd(pigeonhole(values))), float(crossed.df), CONFIDENCE)
    elif crossed is not None:
        low = high = mean  # nothing varies
    return Interval(as_figure(rounded(mean)), as_figure(rounded(low)), as_figure(rounded(high)), _count(values))


def difference(first: Values, second: Values) -> Difference:
    """The mean of ``first - second`` over the cells that both have."""
    with np.errstate(invalid="ignore"):
        gaps = first - second  # inf - inf is nan: two perfect figures say nothing of how far they are apart
    mean, crossed = _crossed(gaps)
    if crossed is None:
        return Difference(mean, math.nan, math.nan, math.nan, _count(gaps))
    if crossed.error <= EPSILON * abs(mean):  # the same difference everywhere: no error is known, and there is no test
        return Difference(mean, mean, mean, math.nan, _count(gaps))
    low, high = crossed.interval(CONFIDENCE)
    return Difference(
        mean, low, high, t_pvalue(mean / float(crossed.error), float(crossed.df), "two-sided"), _count(gaps)
    )


def rounded(value: float) -> float:
    """A figure to seven digits, all that its 32 bits hold: the same whatever order its sums were taken in."""
    return float(f"{value:.7g}")


def _count(values: Values) -> int:
    return int((~np.isnan(values)).sum())


def _crossed(values: Values) -> tuple[float, CrossedMean | None]:
    """The mean, and the model of it where every factor has two levels and all that is known is finite."""
    places = np.nonzero(~np.isnan(values))
    known = values[places]
    mean = float(known.mean()) if len(known) else math.nan
    levels = [np.unique(place, return_inverse=True)[1] for place in places]
    if not np.isfinite(known).all() or min((int(level.max()) for level in levels if len(level)), default=0) < 1:
        return mean, None
    return mean, Crossing(factors=dict(zip(("scenes", "styles"), levels, strict=False))).mean(known)
