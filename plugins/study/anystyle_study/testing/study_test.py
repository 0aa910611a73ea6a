"""What a test of a user study promises: see :class:`anystyle_study.contract.StudyTest`."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np

from anystyle.testing.subject import Subject
from anystyle_study.contract import Responses, StudyTest, TestResult, Unit
from anystyle_study.power import Scenario, simulate


def test_results_are_complete(plugin: Subject[StudyTest]) -> None:
    """At each of its ``units`` it gives a p-value in [0, 1], an estimate in its interval, a count and its method."""
    units = getattr(plugin.cls, "units", None)
    assert units and set(units) <= set(get_args(Unit)), f"units={units!r}; declare a tuple of {get_args(Unit)}"
    for unit in plugin.cls.units:
        for mean in (0.0, -0.8):
            result = _result(plugin, _answers(mean), unit)
            assert result.n >= 1 and result.method and 0 <= result.pvalue <= 1, f"at unit {unit}: {result}"
            low, high = result.interval
            assert low <= result.estimate <= high, f"{unit}: estimate {result.estimate}, interval {low} to {high}"


def test_negative_means_ours(plugin: Subject[StudyTest]) -> None:
    """Where ours is preferred the estimate is negative; with ours and theirs swapped it is as large and positive."""
    for unit in plugin.cls.units:
        answers = _answers(-0.8)
        swapped = replace(answers, deviations=-answers.deviations)
        ours, theirs = _result(plugin, answers, unit).estimate, _result(plugin, swapped, unit).estimate
        symmetric = ours < 0 and math.isclose(ours, -theirs, rel_tol=1e-6, abs_tol=1e-9)
        assert symmetric, f"{unit}: an estimate of {ours:.6g} where ours is preferred, {theirs:.6g} swapped"


def test_too_little_is_not_an_error(plugin: Subject[StudyTest]) -> None:
    """One answer, one participant, or answers without any variation give a result, never an error."""
    neutral = replace(_answers(0.0), deviations=np.zeros(72))
    cases = {
        "a single answer": _answers(-0.8, participants=1, items=1),
        "a single participant": _answers(-0.8, participants=1),
        "a single item": _answers(-0.8, items=1),
        "answers that are all neutral": neutral,
        "answers that are all 1": replace(neutral, deviations=np.full(72, -2.0)),
    }
    for what, answers in cases.items():
        for unit in plugin.cls.units:
            result = _result(plugin, answers, unit)
            told = math.isfinite(result.pvalue) or result.note
            assert told, f"{what} at unit {unit}: no p-value and no note; return `TestResult.untestable(...)`"


def test_testing_twice_is_the_same(plugin: Subject[StudyTest]) -> None:
    """The same answers give the same result, and are left as they were."""
    for unit in plugin.cls.units:
        answers = _answers(-0.3).at(unit)
        before = answers.deviations.copy()
        first, second = plugin.instance(answers), plugin.instance(answers)
        assert first == second, f"{first} and then {second}"
        assert np.array_equal(before, answers.deviations), "other deviations after the test"


def _answers(mean: float, participants: int = 12, items: int = 6) -> Responses:
    """Whole steps of the scale from 1 to 5, so that there are ties as in real answers."""
    (answers,) = simulate(Scenario(participants=participants, items=items, effect=mean), 1, seed=5)
    return answers


def _result(plugin: Subject[StudyTest], answers: Responses, unit: Unit) -> TestResult:
    return plugin.instance(answers.at(unit))
