"""Studies made up by chance, of known preference and known differences between participants and items."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from anystyle.study.contract import Responses, Scale


@dataclass(frozen=True)
class Scenario:
    """How a study's answers come about.

    A latent opinion ``effect + participant + item + noise``, all normal and in points of the scale, is rounded to the
    nearest answer. Without an effect the answers are symmetric about the neutral one.

    Args:
        participants: How many.
        items: How many each one judges.
        effect: Mean preference in points; negative prefers ours.
        participant_sd: Between participants.
        item_sd: Between items.
        residual_sd: Of single opinions.
        scale: Of the answers.
    """

    participants: int = 40
    items: int = 20
    effect: float = 0.0
    participant_sd: float = 0.5
    item_sd: float = 0.2
    residual_sd: float = 1.0
    scale: Scale = Scale()  # noqa: RUF009 (frozen)

    def __post_init__(self) -> None:
        if self.participants < 1 or self.items < 1:
            raise ValueError(f"{self.participants} participants and {self.items} items; expected at least one of each")
        if min(self.participant_sd, self.item_sd, self.residual_sd) < 0:
            raise ValueError("a standard deviation is negative; expected 0 or more")


def simulate(scenario: Scenario, studies: int, seed: int) -> Iterator[Responses]:
    """Draw ``studies`` independent studies; the same seed gives the same ones."""
    generator = np.random.default_rng(seed)
    people, items = scenario.participants, scenario.items
    participant, item = np.divmod(np.arange(people * items), items)
    names = tuple(f"P{index + 1}" for index in range(people)), tuple(f"set-{index + 1}" for index in range(items))
    half = (scenario.scale.high - scenario.scale.low) / 2
    offset = half % 1  # scales of an even number of answers have their steps halfway between whole deviations
    ours_is_a = (participant + item) % 2 == 0
    for _ in range(studies):
        opinion = scenario.effect + generator.normal(0, scenario.residual_sd, (people, items))
        opinion += generator.normal(0, scenario.participant_sd, (people, 1))
        opinion += generator.normal(0, scenario.item_sd, (1, items))
        deviations = np.clip(np.rint(opinion - offset) + offset, -half, half).ravel()
        yield Responses(
            question="simulated",
            deviations=deviations,
            participants=participant,
            items=item,
            participant_names=names[0],
            item_names=names[1],
            ours_is_a=ours_is_a,
            scale=scenario.scale,
        )
