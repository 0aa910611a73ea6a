"""How often each test finds a preference, with one and without, in studies made up by chance."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from anystyle.study.balance import balanced_subsets, draw_pairs
from anystyle.study.contract import Population, Responses, Scale, StudyTest, Unit


@dataclass(frozen=True)
class Scenario:
    """How a study's answers come about.

    A latent opinion, the sum of ``effect``, participant, set, scene, style and noise, all normal and in points of the
    scale, is rounded to the nearest answer. Without an effect the answers are symmetric about the neutral one.

    Args:
        participants: How many.
        items: How many sets each one judges.
        scenes: Of which the sets are made, as evenly as can be.
        styles: The same.
        pool: How many sets there are; 0 for as many as each one judges.
        effect: Mean preference in points; negative prefers ours.
        participant_sd: Between participants.
        item_sd: Between sets of one scene and style.
        scene_sd: Between scenes.
        style_sd: Between styles.
        residual_sd: Of single opinions.
        scale: Of the answers.
    """

    participants: int = 40
    items: int = 20
    scenes: int = 4
    styles: int = 5
    pool: int = 0
    effect: float = 0.0
    participant_sd: float = 0.5
    item_sd: float = 0.2
    scene_sd: float = 0.1
    style_sd: float = 0.1
    residual_sd: float = 1.0
    scale: Scale = Scale()  # noqa: RUF009 (frozen)

    def __post_init__(self) -> None:
        if min(self.participants, self.items, self.scenes, self.styles) < 1:
            raise ValueError(
                f"{self.participants} participants, {self.items} items, {self.scenes} scenes and {self.styles} styles; "
                "expected at least one of each"
            )
        if not self.items <= self.sets <= self.scenes * self.styles:
            raise ValueError(
                f"{self.items} items each of a pool of {self.sets}: {self.scenes} scenes and {self.styles} styles make "
                f"{self.scenes * self.styles} sets; give more with --scenes and --styles"
            )
        if min(self.sds.values()) < 0 or self.residual_sd < 0:
            raise ValueError("a standard deviation is negative; expected 0 or more")

    @property
    def sets(self) -> int:
        """How many sets there are."""
        return self.pool or self.items

    @property
    def sds(self) -> dict[Population, float]:
        """The standard deviation between the levels of each factor."""
        return {
            "participants": self.participant_sd,
            "items": self.item_sd,
            "scenes": self.scene_sd,
            "styles": self.style_sd,
        }


def table(scenario: Scenario, seed: int) -> Responses:
    """Who judges what: the design of a study, every answer neutral."""
    generator = np.random.default_rng(seed)
    people, items, sets = scenario.participants, scenario.items, scenario.sets
    pairs = np.array(draw_pairs(np.ones((scenario.scenes, scenario.styles), dtype=bool), sets, generator))
    subsets = np.tile(np.arange(sets), (people, 1))
    if sets > items:
        subsets = np.repeat(balanced_subsets(pairs, items, (people + 1) // 2, generator), 2, axis=0)[:people]
    participant, column = np.divmod(np.arange(people * items), items)
    return Responses(
        question="simulated",
        deviations=np.zeros(people * items),
        participants=participant,
        items=subsets.ravel(),
        participant_names=tuple(f"P{index + 1}" for index in range(people)),
        item_names=tuple(f"set-{index + 1}" for index in range(sets)),
        item_scenes=tuple(f"scene-{scene}" for scene, _ in pairs),
        item_styles=tuple(f"style-{style}" for _, style in pairs),
        ours_is_a=(participant + column) % 2 == 0,
        scale=scenario.scale,
    )


def simulate(scenario: Scenario, studies: int, seed: int) -> Iterator[Responses]:
    """Draw ``studies`` independent studies of one design; the same seed gives the same ones."""
    drawn, generator = table(scenario, seed), np.random.default_rng((seed, 1))
    names: dict[Population, tuple[str, ...]] = {"scenes": drawn.item_scenes, "styles": drawn.item_styles}
    levels: dict[Population, np.ndarray] = {"participants": drawn.participants, "items": drawn.items}
    for factor, of in names.items():
        levels[factor] = np.unique(of, return_inverse=True)[1][drawn.items]
    half = (scenario.scale.high - scenario.scale.low) / 2
    offset = half % 1  # scales of an even number of answers have their steps halfway between whole deviations
    for _ in range(studies):
        opinion = scenario.effect + generator.normal(0, scenario.residual_sd, drawn.count)
        for factor, sd in scenario.sds.items():
            opinion += generator.normal(0, sd, levels[factor].max() + 1)[levels[factor]]
        yield replace(drawn, deviations=np.clip(np.rint(opinion - offset) + offset, -half, half))


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
            simulated = replace(scenario, participants=number, effect=effect)
            rates += rejection_rates(simulated, tests, studies=studies, seed=seed, level=level)
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
