"""How often each test finds a preference, with one and without: by simulation."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from anystyle.study.contract import StudyTest, Unit
from anystyle.study.simulate import Scenario, simulate


@dataclass(frozen=True)
class Rate:
    """How often a test rejects in a scenario.

    Args:
        test: Its name.
        unit: What it counts as one observation.
        scenario: The studies.
        rejections: How many of them the test rejected.
        studies: How many there were.
        holds_for: For whom the test's p-values hold.
    """

    test: str
    unit: Unit
    scenario: Scenario
    rejections: int
    studies: int
    holds_for: tuple[str, ...]

    @property
    def fraction(self) -> float:
        """The rejection rate."""
        return self.rejections / self.studies

    def interval(self, z: float = 1.96) -> tuple[float, float]:
        """Wilson's interval of the rate."""
        n, fraction = self.studies, self.fraction
        center = (fraction + z**2 / (2 * n)) / (1 + z**2 / n)
        half_width = z / (1 + z**2 / n) * math.sqrt(fraction * (1 - fraction) / n + z**2 / (4 * n**2))
        return min(center - half_width, fraction), max(center + half_width, fraction)


def rejection_rates(
    scenario: Scenario, tests: Mapping[str, StudyTest], *, studies: int, seed: int, level: float = 0.05
) -> list[Rate]:
    """Run every test at each of its units on simulated studies."""
    counts: dict[tuple[str, Unit], int] = {}
    holds: dict[tuple[str, Unit], tuple[str, ...]] = {}
    log_level = math.log(level)
    for responses in simulate(scenario, studies, seed):
        averaged = {unit: responses.at(unit) for test in tests.values() for unit in test.units}
        for name, test in tests.items():
            for unit in test.units:
                result = test(averaged[unit])
                key = name, result.unit
                counts[key] = counts.get(key, 0) + bool(result.log_pvalue <= log_level)
                holds[key] = holds.get(key) or result.generalizes_to
    return [Rate(name, unit, scenario, count, studies, holds[name, unit]) for (name, unit), count in counts.items()]


@dataclass(frozen=True)
class PowerStudy:
    """Rejection rates over numbers of participants.

    Args:
        null: Without a preference, one list a number of participants.
        power: With one, likewise.
        target: The power to reach.
        level: Of the tests.
        seed: Of the simulation.
    """

    null: tuple[Rate, ...]
    power: tuple[Rate, ...]
    target: float
    level: float
    seed: int

    @property
    def tests(self) -> list[tuple[str, Unit]]:
        """Every test and unit, in order."""
        return list(dict.fromkeys((rate.test, rate.unit) for rate in self.power))

    def rates(self, test: str, unit: Unit, *, null: bool = False) -> list[Rate]:
        """The rates of one test, by rising number of participants."""
        rates = [rate for rate in (self.null if null else self.power) if (rate.test, rate.unit) == (test, unit)]
        return sorted(rates, key=lambda rate: rate.scenario.participants)

    def valid(self, test: str, unit: Unit) -> bool:
        """Whether a test keeps its level about where it reaches the target: power bought with errors is none.

        A level is kept if the rate's interval does not lie above it by a third.
        """
        rates, needed = self.rates(test, unit, null=True), self.needed(test, unit)
        near = next((rate for rate in rates if needed and rate.scenario.participants >= needed), rates[-1])
        return near.interval()[0] <= self.level * 4 / 3

    def needed(self, test: str, unit: Unit) -> float | None:
        """Participants for the target power, between the simulated numbers; ``None`` where none of them reaches it.

        Power grows with participants: the rates are made monotone before they are read off on a normal scale.
        """
        rates = self.rates(test, unit)
        people = [float(rate.scenario.participants) for rate in rates]
        heights = np.maximum.accumulate([rate.fraction for rate in rates])
        above = np.flatnonzero(heights >= self.target)
        if not len(above):
            return None
        last = int(above[0])
        if last == 0:
            return people[0]
        step = (self.target - heights[last - 1]) / (heights[last] - heights[last - 1])
        return people[last - 1] + float(step) * (people[last] - people[last - 1])


def power_study(
    scenario: Scenario,
    tests: Mapping[str, StudyTest],
    *,
    participants: Sequence[int],
    studies: int = 1000,
    seed: int = 0,
    level: float = 0.05,
    target: float = 0.8,
    progress: Callable[[str], None] = lambda _: None,
) -> PowerStudy:
    """Simulate the scenario and its twin without an effect, each ``studies`` times, for every number of participants.

    Raises:
        ValueError: There is no effect, or no number of participants.
    """
    if scenario.effect == 0:
        raise ValueError("an effect of 0 cannot be found; give the preference in points, such as --effect -0.3")
    if not participants or min(participants) < 2:
        raise ValueError("no numbers of participants of at least 2 are given; try --participants 10 20 40")
    if studies < 1 or not 0 < level < 1 or not 0 < target < 1:
        raise ValueError(f"studies={studies}, level={level}, target={target}; expected a count and two shares")
    null: list[Rate] = []
    power: list[Rate] = []
    for number in sorted(set(participants)):
        for effect, rates in ((0.0, null), (scenario.effect, power)):
            progress(f"{number} participants, effect {effect:g}")
            one = replace(scenario, participants=number, effect=effect)
            rates += rejection_rates(one, tests, studies=studies, seed=seed, level=level)
    return PowerStudy(tuple(null), tuple(power), target, level, seed)


def power_json(study: PowerStudy) -> dict[str, Any]:
    """The rates as plain data; what ``power.json`` holds."""

    def row(rate: Rate) -> dict[str, Any]:
        return {
            "test": rate.test,
            "unit": rate.unit,
            "scenario": asdict(rate.scenario),
            "rate": rate.fraction,
            "interval": list(rate.interval()),
            "studies": rate.studies,
            "holds_for": list(rate.holds_for),
        }

    return {
        "schema": 1,
        "level": study.level,
        "target": study.target,
        "seed": study.seed,
        "false_positives": [row(rate) for rate in study.null],
        "power": [row(rate) for rate in study.power],
        "participants_needed": [
            {
                "test": test,
                "unit": unit,
                "participants": study.needed(test, unit),
                "keeps_its_level": study.valid(test, unit),
            }
            for test, unit in study.tests
        ],
    }


def power_markdown(study: PowerStudy) -> str:
    """The rates as a table: false positives and power by number of participants, and how many are needed."""
    people = sorted({rate.scenario.participants for rate in study.power})
    first = study.power[0].scenario
    head = ["test", "unit", *(f"false, {n}" for n in people), *(f"power, {n}" for n in people)]
    lines = [
        f"Effect {first.effect:g} points; each participant judges {first.items} of {first.sets} sets of {first.scenes} "
        f"scenes and {first.styles} styles; SD {first.participant_sd:g} between participants, {first.item_sd:g} "
        f"between sets, {first.scene_sd:g} between scenes, {first.style_sd:g} between styles, {first.residual_sd:g} of "
        f"answers; level {study.level:g}; {study.power[0].studies} simulated studies each; participants in the heads.",
        "",
        "| " + " | ".join([*head, f"needed for {study.target:.0%}"]) + " |",
        "|---|---|" + "---:|" * (len(head) - 1),
    ]
    for test, unit in study.tests:
        null = [f"{rate.fraction:.3f}" for rate in study.rates(test, unit, null=True)]
        power = [f"{rate.fraction:.3f}" for rate in study.rates(test, unit)]
        needed = study.needed(test, unit)
        note = "—" if needed is None else f"{math.ceil(needed)}"
        if not study.valid(test, unit):
            note = "invalid"
        lines.append("| " + " | ".join([test.replace("_", " "), unit, *null, *power, note]) + " |")
    lines += ["", "“invalid”: its false positives exceed the level where the power suffices."]
    return "\n".join(lines) + "\n"
