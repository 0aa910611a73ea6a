"""The statistics against scipy, statsmodels, brute force and high precision."""

import itertools
import math

import mpmath
import numpy as np
import pytest
from anystyle.study.bootstrap import bootstrap_mean, tabulate
from anystyle.study.sign_flips import as_integers, exact_log_tails
from anystyle.study.tests.cluster_bootstrap import ClusterBootstrap
from anystyle.study.tests.equivalence import Equivalence
from scipy import stats

from anystyle.study import clmm
from anystyle.study.agreement import krippendorff_alpha
from anystyle.study.contract import Responses
from anystyle.study.effects import effects
from anystyle.study.probability import holm, log_t_cdf
from anystyle.study.signed_rank import pseudo_median
from anystyle.study.tests.one_sample_t import OneSampleT
from anystyle.study.tests.ordinal_mixed import OrdinalMixed
from anystyle.study.tests.sign_flip import SignFlip
from anystyle.study.tests.wilcoxon import Wilcoxon


def table(deviations, ours_is_a=None) -> Responses:
    """Responses of a complete table, participants by items."""
    deviations = np.asarray(deviations, dtype=float)
    people, items = deviations.shape
    participant, item = np.divmod(np.arange(people * items), items)
    return Responses(
        question="style",
        deviations=deviations.ravel(),
        participants=participant,
        items=item,
        ours_is_a=None if ours_is_a is None else np.asarray(ours_is_a).ravel(),
        participant_names=tuple(f"P{index}" for index in range(people)),
        item_names=tuple(f"S{index}" for index in range(items)),
    )


def answers(seed: int, people: int = 40, items: int = 20, shift: float = -0.3) -> Responses:
    random = np.random.default_rng(seed)
    latent = random.normal(shift, 1, (people, items)) + random.normal(0, 0.5, (people, 1))
    return table(np.clip(np.round(latent), -2, 2), random.random((people, items)) < 0.5)


@pytest.mark.parametrize("alternative", ["less", "greater", "two-sided"])
@pytest.mark.parametrize("unit", ["response", "participant", "item"])
@pytest.mark.parametrize("seed", range(4))
def test_t_equals_scipy(seed, unit, alternative):
    rows = answers(seed).at(unit)
    mine, theirs = (
        OneSampleT(alternative=alternative)(rows),
        stats.ttest_1samp(rows.deviations, 0, alternative=alternative),
    )
    assert mine.statistic == pytest.approx(theirs.statistic, rel=1e-12)
    assert mine.pvalue == pytest.approx(theirs.pvalue, rel=1e-10)
    interval = stats.ttest_1samp(rows.deviations, 0).confidence_interval()
    assert mine.interval == pytest.approx((interval.low, interval.high), rel=1e-10)
    assert mine.n == rows.count and mine.estimate == pytest.approx(rows.deviations.mean(), abs=1e-14)


@pytest.mark.parametrize("zero_method", ["wilcox", "pratt", "zsplit"])
@pytest.mark.parametrize("alternative", ["less", "greater", "two-sided"])
@pytest.mark.parametrize("unit", ["response", "participant", "item"])
def test_wilcoxon_equals_scipy_with_ties_and_zeros(unit, alternative, zero_method):
    for seed in range(3):
        rows = answers(seed).at(unit)
        mine = Wilcoxon(alternative=alternative, zero_method=zero_method, method="approx")(rows)
        theirs = stats.wilcoxon(
            rows.deviations, alternative=alternative, zero_method=zero_method, method="approx", correction=False
        )
        if alternative != "two-sided":  # where scipy reports the smaller rank sum
            assert mine.statistic == theirs.statistic
        assert mine.pvalue == pytest.approx(theirs.pvalue, rel=1e-10)


@pytest.mark.parametrize("alternative", ["less", "greater", "two-sided"])
@pytest.mark.parametrize("n", [2, 5, 13])
def test_wilcoxon_is_exact_without_ties(n, alternative):
    values = np.random.default_rng(n).normal(-0.4, 1, (n, 1))
    result = Wilcoxon(alternative=alternative)(table(values))
    sums = np.array(list(itertools.product((0, 1), repeat=n))) @ np.arange(1, n + 1)
    tails = np.mean(sums <= result.statistic), np.mean(sums >= result.statistic)
    expected = {"less": tails[0], "greater": tails[1], "two-sided": min(1, 2 * min(tails))}[alternative]
    assert result.pvalue == pytest.approx(expected, rel=1e-10)
    assert "exact" in result.method


@pytest.mark.parametrize(("shift", "exponent"), [(-0.52, -50), (-1.05, -150), (-1.9, -299)])
def test_tiny_p_values_agree_and_do_not_underflow(shift, exponent):
    random = np.random.default_rng(1)
    values = random.normal(shift, 1, 1500)
    rows = table(values[:, None])
    for mine, theirs in (
        (OneSampleT()(rows), stats.ttest_1samp(values, 0, alternative="less")),
        (
            Wilcoxon(method="approx")(rows),
            stats.wilcoxon(values, alternative="less", method="approx", correction=False),
        ),
    ):
        assert mine.pvalue > 0
        if theirs.pvalue > 1e-300:
            assert mine.pvalue == pytest.approx(theirs.pvalue, rel=1e-10)
            assert mine.log10_pvalue == pytest.approx(math.log10(theirs.pvalue), rel=1e-12)
    assert OneSampleT()(rows).log10_pvalue < exponent


@pytest.mark.parametrize(
    ("statistic", "df"),
    [(-2.0, 39), (-14.0, 799), (-60.0, 5000), (-37.1, 100_000), (-1e8, 39), (-300.0, 99_999), (2.0, 5)],
)
def test_t_tail_against_forty_digits(statistic, df):
    with mpmath.workdps(40):
        half, ratio = mpmath.mpf(df) / 2, df / (df + mpmath.mpf(statistic) ** 2)
        tail = mpmath.betainc(half, mpmath.mpf(1) / 2, 0, ratio, regularized=True) / 2
        expected = float(mpmath.log(tail if statistic < 0 else 1 - tail))
    assert log_t_cdf(statistic, df) == pytest.approx(expected, rel=1e-12)


def test_holm_equals_statsmodels():
    from statsmodels.stats.multitest import multipletests

    pvalues = np.random.default_rng(0).random(9) ** 3
    adjusted = np.exp(holm(np.log(pvalues).tolist()))
    assert adjusted == pytest.approx(multipletests(pvalues, method="holm")[1], rel=1e-12)
    assert holm([math.nan, math.log(0.01)]) == pytest.approx([math.nan, math.log(0.01)], nan_ok=True)


@pytest.mark.parametrize("seed", range(5))
def test_sign_flip_equals_enumeration(seed):
    sums = np.random.default_rng(seed).integers(-9, 8, 11)
    result = SignFlip()(table(sums[:, None] / 4))
    flipped = [np.dot(signs, sums) for signs in itertools.product((-1, 1), repeat=11)]
    assert result.pvalue == pytest.approx(np.mean(np.array(flipped) <= sums.sum()), rel=1e-10)
    two_sided = SignFlip(alternative="two-sided")(table(sums[:, None] / 4)).pvalue
    assert two_sided == pytest.approx(np.mean(np.abs(flipped) >= abs(sums.sum())), rel=1e-10)


def test_sign_flip_of_a_unanimous_study_is_two_to_the_minus_n():
    result = SignFlip()(table(np.full((2000, 3), -2.0)).at("participant"))
    assert result.log_pvalue == pytest.approx(-2000 * math.log(2), rel=1e-12)
    assert result.pvalue == 5e-324
    # One participant of 2000 against all others: the pattern itself, its like for every other one, and unanimity.
    against = np.full((2000, 1), -2.0)
    against[5] = 2.0
    log_lower, log_upper = exact_log_tails(as_integers(against.ravel()))
    assert log_lower == pytest.approx(math.log(2001) - 2000 * math.log(2), rel=1e-12)
    assert log_upper == pytest.approx(0.0, abs=1e-12)


def test_sign_flip_with_unequal_counts_has_a_common_unit():
    values = np.array([-1 / 3, 0.25, -1 / 7, 0.0, -2 / 3])
    assert (as_integers(values) == np.array([-28, 21, -12, 0, -56])).all()
    assert as_integers(np.random.default_rng(0).normal(size=9)) is None


def test_sign_flip_by_random_flips_agrees_with_the_t_test():
    values = np.random.default_rng(3).normal(-0.35, 1, (30, 1))
    result = SignFlip(resamples=20_000)(table(values))
    assert "random flips" in result.method
    t = OneSampleT()(table(values))
    assert result.pvalue == pytest.approx(t.pvalue, rel=0.25)
    assert result.interval == pytest.approx(t.interval, abs=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_pseudo_median_equals_all_pairs(seed):
    values = np.random.default_rng(seed).integers(-3, 3, 31 + seed).astype(float)
    rows, columns = np.triu_indices(len(values))
    means = np.sort((values[rows] + values[columns]) / 2)
    estimate, (low, high) = pseudo_median(values, 0.95)
    assert estimate == pytest.approx(np.median(means), abs=1e-12)
    n = len(values)
    reach = 1.959963984540054 * math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
    k = math.floor(len(means) / 2 - reach)
    assert (low, high) == pytest.approx((means[k - 1], means[len(means) - k]), abs=1e-12)


def test_cohens_d_interval_inverts_the_noncentral_t():
    result = OneSampleT()(answers(0).at("participant"))
    low, high = (math.sqrt(result.n) * bound for bound in result.effect_interval)
    assert stats.nct.sf(result.statistic, result.n - 1, low) == pytest.approx(0.025, abs=1e-6)
    assert stats.nct.cdf(result.statistic, result.n - 1, high) == pytest.approx(0.025, abs=1e-6)


def test_equivalence_equals_statsmodels():
    from statsmodels.stats.weightstats import DescrStatsW

    rows = answers(5, shift=-0.05).at("participant")
    result = Equivalence(margin=0.4)(rows)
    pvalue = DescrStatsW(rows.deviations).ttost_mean(-0.4, 0.4)[0]
    assert result.pvalue == pytest.approx(pvalue, rel=1e-10)
    assert result.confidence == pytest.approx(0.9)


def test_effects_equal_their_definitions():
    rows = answers(2)
    found = {effect.name: effect for effect in effects(rows, resamples=300)}
    d = rows.deviations
    assert found["cohens_d"].estimate == pytest.approx(d.mean() / d.std(ddof=1), rel=1e-12)
    assert found["probability_of_superiority"].estimate == pytest.approx(np.mean(d < 0) + np.mean(d == 0) / 2)
    ranks = stats.rankdata(np.abs(d[d != 0]))
    signed = (ranks * np.sign(d[d != 0])).sum() / ranks.sum()
    assert found["rank_biserial"].estimate == pytest.approx(signed, rel=1e-12)
    assert Wilcoxon()(rows).effect == pytest.approx(signed, rel=1e-12)
    assert all(effect.interval[0] < effect.estimate < effect.interval[1] for effect in found.values())


def test_krippendorff_alpha_of_the_published_example():
    # Krippendorff (2011), "Computing Krippendorff's Alpha-Reliability": four observers, twelve units, ordinal 0.815.
    observers = [
        "1 2 3 3 2 1 4 1 2 . . .",
        "1 2 3 3 2 2 4 1 2 5 . 3",
        ". 3 3 3 2 3 4 2 2 5 1 .",
        "1 2 3 3 2 4 4 1 2 5 1 .",
    ]
    counts = np.zeros((12, 5))
    for line in observers:
        for unit, value in enumerate(line.split()):
            if value != ".":
                counts[unit, int(value) - 1] += 1
    assert krippendorff_alpha(counts) == pytest.approx(0.815, abs=5e-4)


def test_bootstrap_error_of_a_complete_table_is_the_anova_one():
    values = answers(4).deviations.reshape(40, 20)
    rows, columns = values.mean(1), values.mean(0)
    residual = values - rows[:, None] - columns + values.mean()
    squares = 20 * rows.var(ddof=1), 40 * columns.var(ddof=1), (residual**2).sum() / (39 * 19)
    found = bootstrap_mean(tabulate(table(values)), resamples=99, seed=0)
    assert found.error == pytest.approx(math.sqrt((squares[0] + squares[1] - squares[2]) / 800), rel=1e-10)


def test_bootstrap_is_the_same_dense_and_sparse(monkeypatch):
    rows = answers(6)
    keep = np.random.default_rng(0).random(rows.count) < 0.7
    some = Responses(
        question="q",
        deviations=rows.deviations[keep],
        participants=rows.participants[keep],
        items=rows.items[keep],
        participant_names=rows.participant_names,
        item_names=rows.item_names,
    )
    dense = bootstrap_mean(tabulate(some), resamples=50, seed=1)
    monkeypatch.setattr("anystyle.study.bootstrap._DENSE_CELLS", 1)
    sparse = bootstrap_mean(tabulate(some), resamples=50, seed=1)
    assert sparse.error == pytest.approx(dense.error, rel=1e-12)
    assert sparse.studentised == pytest.approx(dense.studentised, rel=1e-9)


@pytest.mark.parametrize("shape", [(12, 7), (5, 9)])
@pytest.mark.parametrize("neutral", [True, False])
def test_ordinal_likelihood_gradient_equals_differences(shape, neutral):
    random = np.random.default_rng(0)
    values = random.integers(-2, 3, shape) + (0.0 if neutral else 0.5)
    model = clmm.OrdinalModel(responses=table(values, random.random(shape) < 0.5))
    place = np.concatenate([[-0.3, 0.2], random.normal(0, 0.3, model.num_thresholds), [0.8, 0.5]])
    _, gradient = model.loglikelihood(place)
    moves = 1e-5 * np.eye(len(place))
    differences = [(model.loglikelihood(place + m)[0] - model.loglikelihood(place - m)[0]) / 2e-5 for m in moves]
    assert gradient == pytest.approx(differences, abs=2e-5)


def test_ordinal_model_without_random_effects_equals_statsmodels():
    """With symmetric data, statsmodels' free thresholds have the same maximum as the symmetric ones."""
    from statsmodels.miscmodels.ordinal_model import OrderedModel

    random = np.random.default_rng(0)
    position = np.repeat([1.0, -1.0], 60)
    half = np.searchsorted([-2, -0.7, 0.7, 2], random.logistic(size=60) + 0.5) - 2.0
    values = np.concatenate([half, -half])  # exchanging positions mirrors the answers
    model = clmm.OrdinalModel(responses=table(values.reshape(12, 10), (position > 0).reshape(12, 10)))
    theirs = OrderedModel(values, position[:, None], distr="logit").fit(method="bfgs", disp=False)
    thresholds = theirs.model.transform_threshold_params(theirs.params)[1:-1]
    spacings = np.log([thresholds[2], thresholds[3] - thresholds[2]])
    value, _ = model.loglikelihood(np.array([0.0, theirs.params[0], *spacings, 0.0, 0.0]))
    assert value == pytest.approx(theirs.llf, abs=1e-4)


def test_laplace_agrees_with_quadrature():
    """With one random effect the marginal likelihood is a product of one-dimensional integrals."""
    random = np.random.default_rng(0)
    values = np.clip(np.round(random.normal(-0.5, 1, (6, 15)) + random.normal(0, 0.7, (6, 1))), -2, 2)
    preference, sd, thresholds = -0.6, 0.9, np.array([0.7, 2.0])
    edges = np.array([-np.inf, *-thresholds[::-1], *thresholds, np.inf])
    nodes, weights = np.polynomial.hermite_e.hermegauss(61)
    eta = preference + sd * nodes[:, None, None]
    level = (values + 2).astype(int)
    chance = 1 / (1 + np.exp(eta - edges[level + 1])) - 1 / (1 + np.exp(eta - edges[level]))
    exact = np.log((weights[:, None] * chance.prod(2)).sum(0) / math.sqrt(2 * math.pi)).sum()
    model = clmm.OrdinalModel(responses=table(values))
    mine, _ = model.loglikelihood(np.array([preference, math.log(0.7), math.log(1.3), 0.0, sd]))
    assert mine == pytest.approx(exact, abs=0.05)


def test_ordinal_fit_recovers_what_made_the_answers():
    random = np.random.default_rng(8)
    ours_is_a = random.random((120, 60)) < 0.5
    latent = -0.8 + 0.3 * np.where(ours_is_a, 1, -1) + random.logistic(size=(120, 60))
    latent += random.normal(0, 0.8, (120, 1)) + random.normal(0, 0.4, (1, 60))
    fitted = clmm.fit(table(np.searchsorted([-2, -0.7, 0.7, 2], latent) - 2.0, ours_is_a))
    assert fitted.converged
    assert abs(fitted.preference + 0.8) < 3 * fitted.error < 0.5
    assert fitted.position == pytest.approx(0.3, abs=0.08)
    assert (fitted.participant_sd, fitted.item_sd) == pytest.approx((0.8, 0.4), abs=0.12)
    assert fitted.thresholds == pytest.approx((0.7, 2.0), abs=0.1)


@pytest.mark.parametrize(
    "test",
    [OneSampleT(), Wilcoxon(), SignFlip(resamples=499), ClusterBootstrap(resamples=499), OrdinalMixed(), Equivalence()],
    ids=lambda test: type(test).__name__,
)
class TestEveryTest:
    def units(self, test, rows):
        return [test(rows.at(unit)) for unit in test.units]

    def test_swapping_the_sides_negates_the_estimate(self, test):
        rows = answers(9)
        swapped = table(-rows.deviations.reshape(40, 20), ~rows.ours_is_a)
        for one, other in zip(self.units(test, rows), self.units(test, swapped), strict=True):
            assert one.estimate == pytest.approx(-other.estimate, abs=1e-5)

    def test_twice_is_the_same_to_the_bit(self, test):
        assert self.units(test, answers(9)) == self.units(test, answers(9))

    @pytest.mark.parametrize("shape", [(1, 1), (1, 6), (6, 1), (6, 6)])
    @pytest.mark.parametrize("score", [0.0, -1.0])
    def test_constant_answers_never_crash(self, test, shape, score):
        for result in self.units(test, table(np.full(shape, score))):
            assert math.isnan(result.pvalue) == bool(result.note)
            assert math.isnan(result.pvalue) or score < 0

    @pytest.mark.parametrize("shape", [(1, 12), (12, 1), (2, 2)])
    def test_small_tables_never_crash(self, test, shape):
        values = np.random.default_rng(0).integers(-2, 3, shape)
        for result in self.units(test, table(values)):
            assert math.isnan(result.pvalue) == bool(result.note)
