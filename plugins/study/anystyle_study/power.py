"""Power and false-positive rate of each test in simulated studies."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy import stats

from anystyle.errors import UserError
from anystyle.evaluation.tables import Table
from anystyle_study.balance import balanced_subsets, draw_pairs
from anystyle_study.contract import Population, Responses, Scale, StudyTest, Unit


@dataclass(frozen=True)
class Scenario:
    """A model of a study's answers.

    A latent opinion, the sum of ``effect`` and of normal effects of participant, set, scene, style and noise, all in
    points of the scale, is rounded to the nearest answer. Without an effect, answers are symmetric about neutral.
    Fields with a help text are flags of ``anystyle study power``.
    """

    participants: int = 40  # number of participants
    items: int = field(default=20, metadata={"help": "sets that each participant judges"})
    scenes: int = field(default=4, metadata={"help": "number of scenes"})  # over which the sets are spread evenly
    styles: int = field(default=5, metadata={"help": "number of styles"})  # likewise
    pool: int = field(default=0, metadata={"help": "sets in all, of which each participant judges a part; 0 for all"})
    effect: float = 0.0  # mean preference in points; negative prefers ours
    participant_sd: float = field(default=0.5, metadata={"help": "SD between participants"})
    item_sd: float = field(default=0.2, metadata={"help": "SD between sets"})  # of one scene and style
    scene_sd: float = field(default=0.1, metadata={"help": "SD between scenes"})
    style_sd: float = field(default=0.1, metadata={"help": "SD between styles"})
    residual_sd: float = field(default=1.0, metadata={"help": "SD between single answers"})
    scale: Scale = Scale()  # noqa: RUF009 (frozen)  # the answer scale

    def __post_init__(self) -> None:
        counts = {name: getattr(self, name) for name in ("participants", "items", "scenes", "styles")}
        if min(counts.values()) < 1:
            given = ", ".join(f"{count} {name}" for name, count in counts.items())
            raise UserError(f"{given}; expected at least one of each")
        pairs = self.scenes * self.styles
        if not self.items <= self.sets <= pairs:
            raise UserError(
                f"{self.items} items each of a pool of {self.sets}: {self.scenes} scenes and {self.styles} styles make "
                f"{pairs} sets; give more with --scenes and --styles"
            )
        sds = (self.residual_sd, *self.sds.values())
        if min(sds) < 0:
            raise UserError("a standard deviation is negative; expected 0 or more")
        if max(sds) == 0:
            raise UserError("every standard deviation is 0: the answers do not vary, and nothing can be tested")
        most = (self.scale.high - self.scale.low) / 2
        if abs(self.effect) > most:
            raise UserError(
                f"an effect of {self.effect:g} points does not fit a scale of {self.scale.low:g} to "
                f"{self.scale.high:g}: give at most {most:g}"
            )

    @property
    def sets(self) -> int:
        """Number of sets in all."""
        return self.pool or self.items

    @property
    def sds(self) -> dict[Population, float]:
        """Standard deviation between the levels of each factor."""
        sds = self.participant_sd, self.item_sd, self.scene_sd, self.style_sd
        return dict(zip(("participants", "items", "scenes", "styles"), sds, strict=True))


def table(scenario: Scenario, seed: int) -> Responses:
    """The design of a simulated study, with every answer neutral."""
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
    scenes, styles = (np.unique(labels, return_inverse=True)[1] for labels in (drawn.item_scenes, drawn.item_styles))
    levels = drawn.participants, drawn.items, scenes[drawn.items], styles[drawn.items]
    half = (scenario.scale.high - scenario.scale.low) / 2
    offset = half % 1  # scales of an even number of answers have their steps halfway between whole deviations
    for _ in range(studies):
        opinion = scenario.effect + generator.normal(0, scenario.residual_sd, drawn.count)
        for level, sd in zip(levels, scenario.sds.values(), strict=True):
            opinion += generator.normal(0, sd, level.max() + 1)[level]
        yield replace(drawn, deviations=np.clip(np.rint(opinion - offset) + offset, -half, half))


@dataclass(frozen=True)
class Rate:
    """How often a test rejects, with and without a preference; intervals are Wilson's at 95 %."""

    test: str  # name of the test
    unit: Unit  # what it counts as one observation
    participants: int  # number of participants
    studies: int  # number of simulated studies of each kind
    generalizes_to: tuple[Population, ...]  # populations that the test's p-values generalise to
    false_positive_rate: float  # rejection rate without a preference
    false_positive_interval: tuple[float, float]
    power: float  # rejection rate with a preference
    power_interval: tuple[float, float]


def rejection_rates(
    scenario: Scenario, tests: Mapping[str, StudyTest], *, studies: int, seed: int, level: float = 0.05
) -> list[Rate]:
    """Run every test at each of its units on studies with the scenario's effect and on studies without one."""
    counts: dict[tuple[str, Unit], list[int]] = defaultdict(lambda: [0, 0])
    claims: dict[tuple[str, Unit], tuple[Population, ...]] = {}
    null = replace(scenario, effect=0.0)
    for kind, simulated in enumerate([null, scenario] if scenario.effect else [null]):
        for responses in simulate(simulated, studies, seed):
            averaged = {unit: responses.at(unit) for test in tests.values() for unit in test.units}
            for name, test in tests.items():
                for result in (test(averaged[unit]) for unit in test.units):
                    key = name, result.unit
                    counts[key][kind] += result.pvalue <= level
                    claims[key] = claims.get(key) or result.generalizes_to

    def rate(count: int) -> tuple[float, tuple[float, float]]:
        interval = stats.binomtest(count, studies).proportion_ci(0.95, method="wilson")
        return count / studies, (float(interval.low), float(interval.high))

    rates = []
    for key, (false, found) in counts.items():
        powers = rate(found if scenario.effect else false)
        rates.append(Rate(*key, scenario.participants, studies, claims[key], *rate(false), *powers))
    return rates


@dataclass(frozen=True)
class PowerStudy:
    """Rejection rates over numbers of participants."""

    level: float  # significance level of the tests
    target: float  # power to reach
    seed: int  # seed of the simulation
    scenario: Scenario  # the simulated studies, but for the number of participants
    rates: tuple[Rate, ...]  # of each test and unit, by rising number of participants

    @property
    def by_test(self) -> dict[tuple[str, Unit], list[Rate]]:
        """The rates of each test and unit, by rising number of participants."""
        groups: dict[tuple[str, Unit], list[Rate]] = defaultdict(list)
        for rate in self.rates:
            groups[rate.test, rate.unit].append(rate)
        return groups

    def valid(self, rates: Sequence[Rate]) -> bool:
        """Whether a test keeps its level about where it reaches the target.

        It does unless the lower end of the false-positive rate's interval exceeds the level by a third.
        """
        needed = self.needed(rates)
        near = next((rate for rate in rates if needed and rate.participants >= needed), rates[-1])
        return near.false_positive_interval[0] <= self.level * 4 / 3

    def needed(self, rates: Sequence[Rate]) -> float | None:
        """Participants for the target power, interpolated; ``None`` if no simulated number reaches it."""
        heights = np.maximum.accumulate([rate.power for rate in rates])  # power grows with participants
        if heights[-1] < self.target:
            return None
        first = int(np.argmax(heights >= self.target))
        reached = slice(max(first - 1, 0), first + 1)
        return float(np.interp(self.target, heights[reached], [rate.participants for rate in rates[reached]]))


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
    """Simulate the scenario with and without its effect, ``studies`` times each, for every number of participants."""
    if scenario.effect == 0:
        raise UserError("an effect of 0 cannot be found; give the preference in points, such as --effect -0.3")
    if not participants or min(participants) < 2:
        raise UserError("no numbers of participants of at least 2 are given; try --participants 10 20 40")
    if studies < 1 or not 0 < level < 1 or not 0 < target < 1:
        raise UserError(f"studies={studies}, level={level}, target={target}; expected a count and two fractions")
    rates: list[Rate] = []
    for number in sorted(set(participants)):
        progress(f"{number} participants")
        simulated = replace(scenario, participants=number)
        rates += rejection_rates(simulated, tests, studies=studies, seed=seed, level=level)
    return PowerStudy(level, target, seed, scenario, tuple(rates))


def power_json(study: PowerStudy) -> dict[str, Any]:
    """The content of ``power.json``."""
    needed = [
        {"test": test, "unit": unit, "participants": study.needed(rates), "keeps_its_level": study.valid(rates)}
        for (test, unit), rates in study.by_test.items()
    ]
    return {"schema": 2} | asdict(study) | {"participants_needed": needed}


def power_table(study: PowerStudy) -> Table:
    """False-positive rate and power by number of participants, and the number needed."""
    people, scenario = list(dict.fromkeys(rate.participants for rate in study.rates)), study.scenario
    numbers = [f"{what}, {number}" for what in ("false positives", "power") for number in people]
    rows = []
    for (test, unit), rates in study.by_test.items():
        needed = study.needed(rates)
        note = "invalid" if not study.valid(rates) else "—" if needed is None else f"{math.ceil(needed)}"
        cells = [f"{rate.false_positive_rate:.3f}" for rate in rates] + [f"{rate.power:.3f}" for rate in rates]
        rows.append((test.replace("_", " "), unit, *cells, note))
    note = (
        f"Each participant judges {scenario.items} of {scenario.sets} sets of {scenario.scenes} scenes and "
        f"{scenario.styles} styles; SD {scenario.participant_sd:g} between participants, {scenario.item_sd:g} "
        f"between sets, {scenario.scene_sd:g} between scenes, {scenario.style_sd:g} between styles, "
        f"{scenario.residual_sd:g} of answers; level {study.level:g}; {study.rates[0].studies} simulated studies "
        "each. invalid: the false-positive rate exceeds the level where the power suffices."
    )
    caption = f"Effect {scenario.effect:g} points, by number of participants"
    return Table(("test", "unit", *numbers, f"needed for {study.target:.0%}"), tuple(rows), caption, (note,))
