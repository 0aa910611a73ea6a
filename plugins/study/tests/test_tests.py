"""The statistics against scipy, brute force and closed forms; see test_goldens.py for R's."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from anystyle_study.contract import Responses
from anystyle_study.significance import CrossedT, OneSampleT, SignFlip, Wilcoxon
from anystyle_study.statistics import Crossing, effects, holm, krippendorff_alpha
from tests.support.study_cases import table

SCENES, STYLES = tuple(f"{item % 5}" for item in range(20)), tuple(f"{item // 5}" for item in range(20))


def answers(seed: int, people: int = 40, items: int = 20, shift: float = -0.3) -> Responses:
    random = np.random.default_rng(seed)
    latent = random.normal(shift, 1, (people, items)) + random.normal(0, 0.5, (people, 1))
    return table(np.clip(np.round(latent), -2, 2), random.random((people, items)) < 0.5)


@pytest.mark.parametrize("zero_method", ["wilcox", "pratt", "zsplit"])
@pytest.mark.parametrize("alternative", ["less", "greater", "two-sided"])
@pytest.mark.parametrize("unit", ["response", "participant", "item"])
def test_wilcoxon_equals_scipy_with_ties_and_zeros(unit, alternative, zero_method):
    for seed in range(3):
        rows = answers(seed).at(unit)
        mine = Wilcoxon(alternative=alternative, zero_method=zero_method, method="approx")(rows)
        options = {"alternative": alternative, "zero_method": zero_method, "method": "approx", "correction": False}
        theirs = stats.wilcoxon(rows.deviations, **options)
        if alternative != "two-sided":  # where scipy reports the smaller rank sum
            assert mine.statistic == theirs.statistic
        assert mine.pvalue == pytest.approx(theirs.pvalue, rel=1e-10)


SMALL = itertools.product([2, 5, 8, 14, 20], ["less", "greater", "two-sided"], ["wilcox", "pratt", "zsplit"])


# scipy's own permutations of 13 answers take seconds
@pytest.mark.parametrize(("n", "alternative", "zero_method"), [*SMALL, (13, "two-sided", "zsplit")])
def test_wilcoxon_permutes_few_answers_with_ties_or_zeros_as_scipy(n, alternative, zero_method):
    random = np.random.default_rng(n)
    for values in (random.integers(-2, 3, n), random.integers(1, 4, n) - 5.0, np.arange(n) - n + 1.0):
        if not values.any():
            continue
        mine = Wilcoxon(alternative=alternative, zero_method=zero_method)(table(values[:, None]))
        options = {"alternative": alternative, "zero_method": zero_method}
        permuted = n <= 13 and (0 in values or len(np.unique(np.abs(values))) < n)
        if permuted:
            theirs = stats.wilcoxon(values, method=stats.PermutationMethod(), **options)
        else:
            theirs = stats.wilcoxon(values, correction=False, **options)
        assert mine.pvalue == pytest.approx(theirs.pvalue, rel=1e-9), values
        assert ("all sign patterns" in mine.method) == permuted


def test_five_people_cannot_show_more_than_their_sign_patterns():
    rows = table(np.array([-1.0, -1.0, -2.0, -1.0, -1.5])[:, None])
    assert Wilcoxon()(rows).pvalue == 2 / 2**5 and Wilcoxon(alternative="less")(rows).pvalue == 1 / 2**5


def test_holm_equals_its_definition():
    pvalues = np.sort(np.random.default_rng(0).random(9) ** 3)
    expected = [min(1.0, max((9 - j) * pvalues[j] for j in range(i + 1))) for i in range(9)]
    shuffle = np.random.default_rng(1).permutation(9)
    assert holm(pvalues[shuffle].tolist()) == pytest.approx(np.array(expected)[shuffle], rel=1e-12)
    assert holm([math.nan, 0.01]) == pytest.approx([math.nan, 0.01], nan_ok=True)


def test_sign_flip_equals_enumeration():
    sums = np.random.default_rng(3).integers(-9, 8, 11)
    flipped = np.array(list(itertools.product((-1, 1), repeat=11))) @ sums
    rows = table(sums[:, None] / 4)
    assert SignFlip(alternative="less")(rows).pvalue == pytest.approx(np.mean(flipped <= sums.sum()), rel=1e-10)
    assert SignFlip()(rows).pvalue == pytest.approx(np.mean(np.abs(flipped) >= abs(sums.sum())), rel=1e-10)


def test_effects_equal_their_definitions():
    rows = answers(2)
    results = {effect.name: effect for effect in effects(rows)}
    d = rows.deviations
    assert results["cohens_d"].estimate == pytest.approx(d.mean() / d.std(ddof=1), rel=1e-12)
    assert results["probability_of_superiority"].estimate == pytest.approx(np.mean(d < 0) + np.mean(d == 0) / 2)
    ranks = stats.rankdata(np.abs(d[d != 0]))
    signed = (ranks * np.sign(d[d != 0])).sum() / ranks.sum()
    assert Wilcoxon()(rows).effect == pytest.approx(signed, rel=1e-12)
    assert all(effect.interval[0] < effect.estimate < effect.interval[1] for effect in results.values())


def test_krippendorff_alpha_of_the_published_example():
    # Krippendorff (2011), "Computing Krippendorff's Alpha-Reliability": four observers, twelve units, ordinal 0.815.
    observers = [
        "1 2 3 3 2 1 4 1 2 . . .",
        "1 2 3 3 2 2 4 1 2 5 . 3",
        ". 3 3 3 2 3 4 2 2 5 1 .",
        "1 2 3 3 2 4 4 1 2 5 1 .",
    ]
    given = np.array([[value.replace(".", "0") for value in line.split()] for line in observers], dtype=int)
    counts = (given[:, :, None] == np.arange(1, 6)).sum(0).astype(float)
    assert krippendorff_alpha(counts) == pytest.approx(0.815, abs=5e-4)


def test_crossed_moments_are_unbiased_in_an_incomplete_table():
    """The expected squares of independent effects, by trace, against plain linear algebra."""
    random = np.random.default_rng(0)
    factors = {name: random.integers(0, size, 60) for name, size in (("participants", 9), ("items", 7), ("styles", 3))}
    members = [np.eye(int(codes.max()) + 1)[codes] for codes in factors.values()]
    variances, center = (0.5, 0.3, 0.2, 1.1), np.eye(60) - 1 / 60
    covariance = sum(v * m @ m.T for v, m in zip(variances, [*members, np.eye(60)], strict=True))
    root = np.linalg.cholesky(covariance)
    # Columns whose outer products sum to the covariance stand for all draws: moments are quadratic.
    crossing = Crossing(factors=factors)
    squares = np.array([((m.T @ center @ root) ** 2).sum() for m in [*members, np.eye(60)]])
    raw = crossing._inverse @ squares
    assert raw == pytest.approx(variances, rel=1e-9)


def test_scenes_and_styles_widen_the_interval_and_the_claim():
    rows = answers(3)
    shared = replace(rows, item_scenes=SCENES, item_styles=STYLES)
    assert CrossedT()(rows).generalizes_to == ("participants", "items")
    assert CrossedT()(shared).generalizes_to == ("participants", "scenes", "styles")
    two = replace(shared, item_scenes=tuple(f"{i % 2}" for i in range(20)))
    assert two.populations == ("participants", "styles")  # two scenes speak of no others
    alone = replace(rows, item_scenes=rows.item_names, item_styles=rows.item_names)
    assert alone.populations == ("participants", "scenes", "styles")
    assert CrossedT()(alone).interval == CrossedT()(rows).interval


def test_one_sided_claims_have_one_sided_intervals():
    rows = answers(4)
    for test in (OneSampleT, Wilcoxon, SignFlip, CrossedT):
        unit = test.units[-1]
        both, less, greater = (
            test(alternative=alternative)(rows.at(unit)) for alternative in ("two-sided", "less", "greater")
        )
        assert less.interval[0] == -math.inf and greater.interval[1] == math.inf, test
        assert both.interval[0] < greater.interval[0] < less.interval[1] < both.interval[1], test
        assert both.pvalue == pytest.approx(2 * min(less.pvalue, greater.pvalue), rel=0.05)


def test_ties_and_few_people_that_leave_no_interval_are_told():
    result = Wilcoxon()(table(np.repeat([0.0, -1.0, 1.0], [80, 12, 8])[:, None]))
    assert math.isnan(result.interval[0]) and "ties" in result.note
    for test in (Wilcoxon(), SignFlip()):  # of five the least p-value is 0.0625, of six 0.03125
        assert math.isnan((few := test(answers(5, 5).at("participant"))).interval[0]) and "too few" in few.note
        six = answers(5, 6).at("participant")
        assert test(six).interval == (six.deviations.min(), six.deviations.max())


def test_the_crossed_mean_of_a_complete_table_claims_no_more_than_one_factor_alone():
    """Negative components, as scenes and styles have in half of all tables without their variance, lower no error."""
    for seed in range(20):
        rows = replace(answers(seed, people=24), item_scenes=SCENES, item_styles=STYLES)
        crossed = CrossedT()(rows)
        for unit in ("participant", "item"):
            assert crossed.pvalue >= OneSampleT()(rows.at(unit)).pvalue * (1 - 1e-9), (seed, unit)
