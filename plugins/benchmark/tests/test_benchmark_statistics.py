"""Intervals over crossed scenes and styles against closed forms, a loop, and simulated benchmarks."""

import math

import numpy as np
import pytest
from scipy import stats

from anystyle_benchmark.results import CellFigures, Interval, SceneFigures
from anystyle_benchmark.statistics import arranged, difference, interval, pigeonhole
from anystyle_study.statistics import Crossing


def crossed(random, scenes, styles, *sds):
    shapes = ((scenes, 1), (1, styles), (scenes, styles))
    return sum(sd * random.normal(size=shape) for sd, shape in zip(sds, shapes, strict=True))


def test_the_bootstrap_is_what_a_loop_over_drawn_cells_gives():
    random = np.random.default_rng(1)
    values = crossed(random, 5, 4, 1.0, 0.5, 0.7)
    values[1, 2] = values[4, 0] = np.nan
    means = []
    for _ in range(20_000):
        rows, columns = random.integers(0, 5, 4), random.integers(0, 4, 3)
        drawn = [values[row, column] for row in rows for column in columns]
        known = [value for value in drawn if not math.isnan(value)]
        means.append(sum(known) / len(known) if known else math.nan)
    ours = pigeonhole(values, draws=20_000)
    quantiles = [2.5, 25, 50, 75, 97.5]
    np.testing.assert_allclose(
        np.nanpercentile(ours, quantiles), np.nanpercentile(means, quantiles), rtol=0, atol=0.04 * np.nanstd(means)
    )
    np.testing.assert_array_equal(ours, pigeonhole(values, draws=20_000))  # one seed, one result


def test_its_error_is_the_closed_form_where_cells_share_nothing_else():
    random = np.random.default_rng(2)
    scenes, styles = random.normal(0, 1.0, (4, 1)), random.normal(0, 0.4, (1, 9))
    exact = math.sqrt(scenes.var(ddof=1) / 4 + styles.var(ddof=1) / 9)
    values = scenes + styles
    places = dict(zip(("scenes", "styles"), (level.ravel() for level in np.indices(values.shape)), strict=True))
    assert float(Crossing(factors=places).mean(values.ravel()).error) == pytest.approx(exact, rel=1e-9)
    assert np.std(pigeonhole(values, draws=100_000)) == pytest.approx(exact, rel=0.01)
    whole = scenes[:, 0]
    assert np.std(pigeonhole(whole, draws=100_000)) == pytest.approx(whole.std(ddof=1) / 2, rel=0.01)


@pytest.mark.parametrize(("scenes", "styles", "sds"), [(4, 12, (1, 0.3, 0.3)), (3, 6, (0.3, 1, 1))])
def test_intervals_cover_the_truth_as_often_as_they_say(scenes, styles, sds):
    """Of 400 simulated benchmarks; by chance alone the share is within 0.022 of what it is, in two standard errors."""
    random = np.random.default_rng(3)
    tables = [crossed(random, scenes, styles, *sds) for _ in range(400)]
    means = [interval(table) for table in tables]
    assert 0.92 <= np.mean([one.low < 0 < one.high for one in means]) <= 0.999
    gaps = [difference(table, np.zeros_like(table)) for table in tables]
    assert 0.92 <= np.mean([gap.low < 0 < gap.high for gap in gaps]) <= 0.99
    outside = np.mean([not gap.low < 0 < gap.high for gap in gaps])
    assert np.mean([gap.pvalue <= 0.05 for gap in gaps]) == pytest.approx(outside)


def test_seeds_are_averaged_and_both_methods_lie_in_one_table():
    def cell(method, seed, scene, style, **figures):
        return CellFigures(method, seed, scene, style, "image", "done", figures=figures)

    ours = [cell("a", seed, "s", "x", f=float(seed), g=1.0) for seed in range(3)] + [cell("a", 0, "s", "y", f=7.0)]
    first, second = arranged("f", ours, [cell("b", 0, "t", "x", f=2.0), cell("b", 0, "s", "y", f=None)])
    np.testing.assert_array_equal(first, [[1, 7], [np.nan, np.nan]])
    np.testing.assert_array_equal(second, [[np.nan, np.nan], [2, np.nan]])
    assert difference(first, second).n == 0
    (whole,) = arranged("kid", [SceneFigures("a", seed, "s", "image", {"kid": 2.0 * seed}) for seed in range(2)])
    np.testing.assert_array_equal(whole, [1])
    assert arranged("nothing", ours)[0].size == 0


def test_what_cannot_be_told_has_no_bounds():
    assert interval(np.array([[1.0, 2.0, 3.0]])) == Interval(
        2.0, None, None, 3
    )  # of one scene nothing is known of others
    assert interval(np.array([[1.0, np.inf], [1.0, 2.0]])) == Interval("inf", None, None, 4)
    assert interval(np.full((3, 2), 0.5)) == Interval(0.5, 0.5, 0.5, 6)
    assert interval(np.full((2, 2), np.nan)) == Interval(None, None, None, 0)
    assert math.isnan(difference(np.ones((1, 3)), np.zeros((1, 3))).pvalue)
    assert math.isnan(difference(np.full((2, 3), 0.1), np.zeros((2, 3))).pvalue)  # no error is known
    assert math.isnan(difference(np.ones((2, 3)), np.ones((2, 3))).pvalue)


def test_differences_of_scenes_are_students():
    random = np.random.default_rng(4)
    first, second = random.normal(0.5, 1, 6), random.normal(0, 1, 6)
    expected = stats.ttest_rel(first, second)
    ours = difference(first, second)
    assert ours.pvalue == pytest.approx(expected.pvalue, rel=1e-9)
    assert (ours.low, ours.high) == pytest.approx(tuple(expected.confidence_interval(0.95)), rel=1e-9)
