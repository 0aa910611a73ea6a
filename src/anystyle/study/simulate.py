"""Studies made up by chance, of known preference and known differences between people, sets, scenes and styles."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from anystyle.study.balance import balanced_subsets, draw_pairs
from anystyle.study.contract import Population, Responses, Scale


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
