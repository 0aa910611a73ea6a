"""What a test of a user study is given, returns and promises.

Signs, everywhere: a score of 1 says that A is much better; after the positions are undone a low score prefers *ours*.
Tests see deviations from the scale's neutral point, so a negative estimate means that ours is preferred.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from anystyle.registry.socket import Socket

Unit = Literal["response", "participant", "item"]
"""What a test counts as one independent observation."""

Alternative = Literal["less", "greater", "two-sided"]
"""Which side of the neutral point is the claim; ``less`` claims that ours is preferred."""

Population = Literal["participants", "items", "scenes", "styles"]
"""Of what a claim holds for new ones; ``items`` are new sets of the scenes and styles that were shown."""

LEAST_LEVELS = 3
"""Scenes, or styles, from which others may be spoken of: below, a claim is of these."""

TINY = 5e-324
"""The smallest positive double: a p-value below it is given by its logarithm alone."""


@dataclass(frozen=True)
class Scale:
    """An answer scale, its ends included; its middle says that neither is better."""

    low: float = 1.0
    high: float = 5.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(f"scale {self.low:g} to {self.high:g}: expected two finite numbers, the lower one first")

    @property
    def midpoint(self) -> float:
        """The neutral answer."""
        return (self.low + self.high) / 2

    @property
    def levels(self) -> tuple[float, ...]:
        """The whole-step answers from low to high."""
        return tuple(self.low + step for step in range(int(self.high - self.low) + 1))


@dataclass(frozen=True)
class Responses:
    """The answers to one question.

    Args:
        question: Its name.
        deviations: Score minus the scale's neutral point, positions undone; negative prefers ours.
        participants: Who answered, as an index into ``participant_names``; -1 where participants are averaged over.
        items: What was judged, as an index into ``item_names``; -1 where items are averaged over.
        ours_is_a: Whether ours was shown as A; ``None`` after averaging.
        scale: The answer scale.
        participant_names: One a participant.
        item_names: One an item.
        item_scenes: The scene of each item; empty where it is not known.
        item_styles: The style of each item; empty where it is not known.
        ratings: The mean ratings of ours and of theirs, where the deviations are differences of ratings.
        unit: What one row is.
    """

    question: str
    deviations: Float[np.ndarray, " N"]
    participants: Int[np.ndarray, " N"]
    items: Int[np.ndarray, " N"]
    participant_names: tuple[str, ...]
    item_names: tuple[str, ...]
    ours_is_a: Bool[np.ndarray, " N"] | None = None
    scale: Scale = Scale()
    item_scenes: tuple[str, ...] = ()
    item_styles: tuple[str, ...] = ()
    ratings: tuple[float, float] | None = None
    unit: Unit = "response"

    @property
    def count(self) -> int:
        """How many rows there are."""
        return len(self.deviations)

    @property
    def item_titles(self) -> tuple[str, ...]:
        """The items as people call them: scene and style where both are known."""
        if not (self.item_scenes and self.item_styles):
            return self.item_names
        return tuple(f"{scene}, {style}" for scene, style in zip(self.item_scenes, self.item_styles, strict=True))

    @property
    def factors(self) -> dict[Population, Int[np.ndarray, " N"]]:
        """The level of every answer in each factor of at least two levels (:data:`LEAST_LEVELS` scenes or styles)."""
        codes: dict[Population, np.ndarray] = {"participants": self.participants, "items": self.items}
        for factor, names in self._shared.items():
            codes[factor] = np.unique(names, return_inverse=True)[1][self.items]
        levels: dict[Population, np.ndarray] = {}
        for factor, of in codes.items():
            levels[factor] = np.unique(of, return_inverse=True)[1]
        items = levels["items"].max(initial=0)
        return {
            factor: level
            for factor, level in levels.items()
            # A scene of its own for every item is the item.
            if level.max(initial=0) > 0 and not (factor in self._shared and level.max() == items)
        }

    @property
    def _shared(self) -> dict[Population, tuple[str, ...]]:
        """The names, item by item, of the scenes or styles that count as drawn at random."""
        named: dict[Population, tuple[str, ...]] = {"scenes": self.item_scenes, "styles": self.item_styles}
        judged = set(self.items.tolist())
        return {
            factor: names
            for factor, names in named.items()
            if names and len({names[item] for item in judged}) >= LEAST_LEVELS
        }

    @property
    def populations(self) -> tuple[Population, ...]:
        """For whom a test holds that takes every factor as drawn at random."""
        factors = self.factors
        participants: tuple[Population, ...] = ("participants",) if "participants" in factors else ()
        sets: tuple[Population, ...] = ("items",)
        return (*participants, *((tuple(self._shared) or sets) if "items" in factors else ()))

    def at(self, unit: Unit) -> "Responses":
        """One row a ``unit``: its mean deviation. Participants and items without an answer are left out."""
        if unit == self.unit:
            return self
        if self.unit != "response":
            raise ValueError(f"rows are one a {self.unit} already; average the responses by {unit} instead")
        codes, names = {
            "participant": (self.participants, self.participant_names),
            "item": (self.items, self.item_names),
        }[unit]
        counts = np.bincount(codes, minlength=len(names))
        present = np.flatnonzero(counts)
        means = np.bincount(codes, weights=self.deviations, minlength=len(names))[present] / counts[present]
        absent = np.full(len(present), -1)
        return replace(
            self,
            deviations=means,
            participants=present if unit == "participant" else absent,
            items=present if unit == "item" else absent,
            ours_is_a=None,
            unit=unit,
        )


@dataclass(frozen=True)
class TestResult:
    """What a test found.

    Args:
        unit: What was counted as one observation.
        statistic: The test statistic; ``nan`` where the test cannot be made.
        log_pvalue: Natural logarithm of the p-value, which may be far below the smallest double.
        alternative: The claim tested against no preference.
        estimate: The preference, in ``estimate_unit``; negative means ours is preferred.
        interval: Of the estimate, at ``confidence`` and of the sides of ``alternative``; ``nan`` where there is none.
        n: Observations, as the test counts them.
        effect: A standardised effect, signed like the estimate unless it is a probability.
        effect_name: Such as ``cohens_d``.
        effect_interval: Of the effect, at ``confidence``.
        confidence: Of both intervals.
        method: One line that says exactly what was computed.
        note: What a reader must know besides; empty if nothing.
        generalizes_to: For new ones of what the p-value holds.
        estimate_unit: ``points`` of the answer scale, or what else the estimate is in.
    """

    __test__: ClassVar[bool] = False  # the name is the field's; pytest need not collect it

    unit: Unit
    statistic: float
    log_pvalue: float
    alternative: str
    estimate: float
    interval: tuple[float, float]
    n: int
    effect: float = math.nan
    effect_name: str = ""
    effect_interval: tuple[float, float] = (math.nan, math.nan)
    confidence: float = 0.95
    method: str = ""
    note: str = ""
    generalizes_to: tuple[Population, ...] = ()
    estimate_unit: str = "points"

    @property
    def pvalue(self) -> float:
        """The p-value; never 0, and the smallest double where it is smaller still."""
        return math.nan if math.isnan(self.log_pvalue) else max(math.exp(self.log_pvalue), TINY)

    @property
    def log10_pvalue(self) -> float:
        """The p-value's decimal logarithm, exact where the p-value itself underflows."""
        return self.log_pvalue / math.log(10)

    @classmethod
    def untestable(cls, responses: Responses, *, reason: str, alternative: str, method: str = "") -> "TestResult":
        """The result where the answers allow no such test, with the reason in its note."""
        estimate = float(np.mean(responses.deviations)) if responses.count else math.nan
        return cls(
            unit=responses.unit,
            statistic=math.nan,
            log_pvalue=math.nan,
            alternative=alternative,
            estimate=estimate,
            interval=(math.nan, math.nan),
            n=responses.count,
            method=method,
            note=reason,
        )


class StudyTest(Socket, ABC):
    """One statistical test of one question.

    Swapping ours and theirs (negating every deviation) negates the estimate. Answers that allow no test, such as
    those of one participant or without any variation, give :meth:`TestResult.untestable`, never an error.
    """

    units: ClassVar[tuple[Unit, ...]]
    """The units it is run at; the framework averages the responses to each before the call."""

    @abstractmethod
    def __call__(self, responses: Responses) -> TestResult:
        """Test whether the answers differ from no preference."""


def generalization(unit: Unit) -> tuple[Population, ...]:
    """For whom a p-value holds that counts each ``unit`` as independent: single responses stand for nobody."""
    return {"response": (), "participant": ("participants",), "item": ("items",)}[unit]
