"""What a test of the user study promises: see :class:`anystyle.study.contract.StudyTest`."""

import math
from dataclasses import replace
from typing import get_args

import numpy as np

from anystyle.study.contract import Responses, StudyTest, TestResult, Unit
from anystyle.testing.check import Check, attempt, expect
from anystyle.testing.subject import Subject

Plugin = Subject[StudyTest]

UNITS = get_args(Unit)


def units_are_declared(plugin: Plugin) -> None:
    """``units`` says what it counts as one observation."""
    units = getattr(plugin.cls, "units", None)
    expect(
        isinstance(units, tuple) and bool(units) and set(units) <= set(UNITS),
        given=f"units = {units!r}",
        expected=f"a tuple of some of {', '.join(UNITS)}",
        change="declare it as a class attribute",
    )


def results_are_complete(plugin: Plugin) -> None:
    """At each of its units it gives a p-value in (0, 1], an estimate within its interval, a count and its method."""
    for unit in plugin.cls.units:
        for what, answers in (("answers without a preference", _answers(0.0)), ("a clear preference", _answers(-0.8))):
            result = _tested(plugin, answers, unit)
            where = f"at unit {unit}, for {what}"
            expect(
                isinstance(result, TestResult) and result.unit in UNITS and result.n >= 1 and bool(result.method),
                given=f"{where}: {result!r}",
                expected="a TestResult with its unit, count and method",
                change="fill in `unit`, `n` and `method`",
            )
            expect(
                0 < result.pvalue <= 1 and math.isfinite(result.estimate),
                given=f"{where}: a p-value of {result.pvalue:.3g} and an estimate of {result.estimate:.3g}",
                change="pass the natural logarithm of the p-value as `log_pvalue`",
            )
            low, high = result.interval
            expect(
                low <= result.estimate <= high,
                given=f"{where}: an estimate of {result.estimate:.3g} and an interval from {low:.3g} to {high:.3g}",
                expected="an interval around the estimate, on the answer scale",
                change="return both on the same scale, lower end first",
            )


def negative_means_ours(plugin: Plugin) -> None:
    """Where ours is preferred the estimate is negative; with ours and theirs swapped it is as large and positive."""
    for unit in plugin.cls.units:
        answers = _answers(-0.8)
        ours, theirs = _tested(plugin, answers, unit), _tested(plugin, _swapped(answers), unit)
        expect(
            ours.estimate < 0,
            given=f"at unit {unit}: an estimate of {ours.estimate:.3g} where ours is preferred",
            change="test `responses.deviations` as they are: low scores prefer ours",
        )
        expect(
            math.isclose(ours.estimate, -theirs.estimate, rel_tol=1e-6, abs_tol=1e-9),
            given=f"at unit {unit}: estimates of {ours.estimate:.6g} and, swapped, {theirs.estimate:.6g}",
            change="use a statistic that is symmetric about 0",
        )


def too_little_is_not_an_error(plugin: Plugin) -> None:
    """One answer, one participant, or answers without any variation give a result, never an error."""
    cases = {
        "a single answer": _answers(-0.8, participants=1, items=1),
        "a single participant": _answers(-0.8, participants=1),
        "a single item": _answers(-0.8, items=1),
        "answers that are all neutral": _constant(0.0),
        "answers that are all 1": _constant(-2.0),
    }
    for what, answers in cases.items():
        for unit in plugin.cls.units:
            change = (
                "return `TestResult.untestable(responses, reason=..., alternative=...)` where the test is undefined"
            )
            with attempt(f"testing {what} at unit {unit}", change=change):
                result = _tested(plugin, answers, unit)
            expect(
                isinstance(result, TestResult) and (math.isfinite(result.log_pvalue) or bool(result.note)),
                given=f"{what} at unit {unit}: a p-value of {result.pvalue} and no note",
                expected="a p-value, or a note that says why there is none",
                change=change,
            )


def testing_twice_is_the_same(plugin: Plugin) -> None:
    """The same answers give the same result, and are left as they were."""
    for unit in plugin.cls.units:
        answers = _answers(-0.3).at(unit)
        kept = answers.deviations.copy()
        once, twice = plugin.instance(answers), plugin.instance(answers)
        change = "draw from a numpy generator with an explicit seed, made in each call"
        expect(once == twice, given=f"{once} and then {twice}", change=change)
        expect(
            bool(np.array_equal(kept, answers.deviations)),
            given="other deviations after the test",
            change="copy arrays before sorting or centring them in place",
        )


def _answers(mean: float, participants: int = 12, items: int = 5) -> Responses:
    # Whole steps of the usual scale from 1 to 5, so that there are ties as in real answers.
    random = np.random.default_rng(5)
    count = participants * items
    scores = np.clip(np.rint(mean + random.normal(0, 1.0, count)), -2, 2)
    return Responses(
        question="style",
        deviations=scores.astype(np.float64),
        participants=np.repeat(np.arange(participants), items),
        items=np.tile(np.arange(items), participants),
        participant_names=tuple(f"p{index}" for index in range(participants)),
        item_names=tuple(f"i{index}" for index in range(items)),
        ours_is_a=random.random(count) < 0.5,
    )


def _constant(value: float) -> Responses:
    answers = _answers(0.0)
    return replace(answers, deviations=np.full(answers.count, value))


def _swapped(answers: Responses) -> Responses:
    return replace(answers, deviations=-answers.deviations)


def _tested(plugin: Plugin, answers: Responses, unit: Unit) -> TestResult:
    return plugin.instance(answers.at(unit))


CHECKS: tuple[Check, ...] = (
    Check(units_are_declared, needed=True),
    Check(results_are_complete, needed=True),
    Check(negative_means_ours),
    Check(too_little_is_not_an_error),
    Check(testing_twice_is_the_same),
)
