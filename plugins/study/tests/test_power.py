"""Calibration by simulation, and power against closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from anystyle_study.contract import Scale
from anystyle_study.power import PowerStudy, Scenario, power_json, power_study, power_table, rejection_rates, simulate
from anystyle_study.significance import CrossedT, OneSampleT, SignFlip, Wilcoxon

CALIBRATED = {
    "one_sample_t": OneSampleT(),
    "wilcoxon": Wilcoxon(),
    "sign_flip": SignFlip(resamples=99),
    "crossed_t": CrossedT(),
}


def rates_of(scenario, tests, studies, seed):
    rates = rejection_rates(scenario, tests, studies=studies, seed=seed)
    return {(rate.test, rate.unit): rate.power for rate in rates}


ALIKE = {"item_sd": 0.0, "scene_sd": 0.0, "style_sd": 0.0}


@pytest.mark.slow
def test_false_positives_when_participants_differ():
    """The paper's design, no preference, an SD of 0.5 between participants: what may be believed, and what may not."""
    rates = rates_of(Scenario(participant_sd=0.5, **ALIKE), CALIBRATED, studies=500, seed=11)
    for name in ("one_sample_t", "wilcoxon", "sign_flip"):
        assert rates[name, "participant"] == pytest.approx(0.05, abs=0.025), name
    assert rates["crossed_t", "participant"] < 0.065
    # 800 answers of 40 people are not 800 independent ones, nor do items stand for other people: the tests take the
    # mean's variance for `taken`, and reject as often as a t of the true variance lies beyond their critical value.
    people, single = 0.25, 1 + 1 / 12  # between people; of single answers, with that of rounding
    variance = people / 40 + single / 800
    for name in ("one_sample_t", "wilcoxon"):
        for unit, taken, df in (("response", (people + single) / 800, 799), ("item", single / 800, 19)):
            expected = 2 * stats.t.sf(stats.t.ppf(0.975, df) * math.sqrt(taken / variance), df)
            assert rates[name, unit] == pytest.approx(expected, abs=0.06), (name, unit)


def test_power_of_the_participant_t_test_is_the_noncentral_t():
    """On a fine scale the means are as good as normal, and the power is known."""
    scenario = Scenario(
        participants=16, items=10, effect=-3.0, participant_sd=5.0, residual_sd=4.0, **ALIKE, scale=Scale(0.0, 100.0)
    )
    tests = {"one_sample_t": OneSampleT(alternative="less")}
    found = rates_of(scenario, tests, studies=1500, seed=3)["one_sample_t", "participant"]
    sd = math.sqrt(25 + (16 + 1 / 12) / 10)
    assert found == pytest.approx(stats.nct.cdf(stats.t.ppf(0.05, 15), 15, -3 / sd * 4), abs=0.04)


def test_simulated_studies_are_symmetric_without_an_effect_and_repeatable():
    for scale, steps in ((Scale(1.0, 5.0), {-2, -1, 0, 1, 2}), (Scale(1.0, 4.0), {-1.5, -0.5, 0.5, 1.5})):
        drawn = [one.deviations for one in simulate(Scenario(scale=scale), 60, seed=4)]
        again = [one.deviations for one in simulate(Scenario(scale=scale), 60, seed=4)]
        assert all((a == b).all() for a, b in zip(drawn, again, strict=True))
        values = np.concatenate(drawn)
        assert set(values.tolist()) == steps and abs(values.mean()) < 0.06


@pytest.fixture(scope="module")
def study():
    tests = {"one_sample_t": OneSampleT(alternative="less")}
    return power_study(Scenario(effect=-0.4, **ALIKE), tests, participants=(6, 12, 24, 48), studies=300, seed=1)


def test_participants_needed_lie_where_the_power_crosses(study: PowerStudy):
    rates = study.by_test["one_sample_t", "participant"]
    needed = study.needed(rates)
    # Closed form: the smallest n whose noncentral t has 80 % beyond the 5 % point.
    sd = math.sqrt(0.25 + (1 + 1 / 12) / 20)
    n = next(n for n in range(3, 99) if stats.nct.cdf(stats.t.ppf(0.05, n - 1), n - 1, -0.4 / sd * math.sqrt(n)) > 0.8)
    assert needed == pytest.approx(n, abs=4) and study.needed(rates[:1]) is None


def test_power_as_table_and_data(study: PowerStudy):
    rows = [row for row in power_json(study)["rates"] if row["unit"] == "participant"]
    assert [row["participants"] for row in rows] == [6, 12, 24, 48]
    assert all(row["power_interval"][0] <= row["power"] <= row["power_interval"][1] for row in rows)
    (response,) = [row for row in power_table(study).rows if row[:2] == ("one sample t", "response")]
    assert response[-1] == "invalid"  # power bought with false positives


@pytest.mark.parametrize(
    ("scenario", "options", "told"),
    [
        ({}, {"participants": ()}, "--participants"),
        ({}, {"participants": (1,)}, "at least 2"),
        ({}, {"studies": 0}, "studies=0"),
        ({}, {"target": 1.0}, "target=1"),
        ({"effect": 0.0}, {}, "an effect of 0"),
        ({"item_sd": -1.0}, {}, "negative"),
        ({"participants": 0}, {}, "0 participants"),
        ({"effect": 9.0}, {}, "effect of 9 points .* scale of 1 to 5: .* at most 2"),
        ({"effect": -2.5}, {}, "effect of -2.5 points .* at most 2"),
        ({"residual_sd": 0.0, "participant_sd": 0.0, **ALIKE}, {}, "answers do not vary"),
        ({"items": 20, "scenes": 4, "styles": 3}, {}, "make 12 sets"),
    ],
)
def test_power_of_nothing_is_refused(scenario, options, told):
    with pytest.raises(ValueError, match=told):
        power_study(Scenario(**{"effect": -0.2, **scenario}), {}, **{"participants": (4,), "studies": 5, **options})


def test_simulated_studies_have_the_design_of_a_drawn_one():
    (one,) = simulate(Scenario(participants=12, items=6, pool=18, scenes=6, styles=4), 1, seed=0)
    assert (np.bincount(one.participants) == 6).all()
    assert np.ptp(np.bincount(one.items)) <= 2  # both of a pair of participants judge the same sets
    assert one.populations == ("participants", "scenes", "styles")
