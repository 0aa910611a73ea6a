"""The contract of a statistical test of a user study: its input, its output and what it guarantees.

Sign convention: a score of 1 says that A is much better, and once the display positions are undone a low score prefers
*ours*. Tests see deviations from the neutral answer, so a negative estimate means that ours is preferred.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from anystyle.contracts import Pluggable
from anystyle.errors import UserError

Unit = Literal["response", "participant", "item"]
"""What a test counts as one independent observation."""

Alternative = Literal["less", "greater", "two-sided"]
"""Which side of the neutral point is the claim; ``less`` claims that ours is preferred."""

Population = Literal["participants", "items", "scenes", "styles"]
"""What a claim generalises to; ``items`` are new sets of the scenes and styles that were shown."""

MIN_LEVELS = 3
"""Fewer scenes (or styles) are treated as fixed: claims do not generalise to others."""


@dataclass(frozen=True)
class Scale:
    """An answer scale, ends included; its middle is the neutral answer."""

    low: float = 1.0
    high: float = 5.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise UserError(f"scale {self.low:g} to {self.high:g}: expected two finite numbers, the lower one first")

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
    """The answers to one question, one row per observation."""

    question: str  # its name
    deviations: Float[np.ndarray, " N"]  # score minus the neutral answer, positions undone; negative prefers ours
    participants: Int[np.ndarray, " N"]  # index into ``participant_names``; -1 after averaging over participants
    items: Int[np.ndarray, " N"]  # index into ``item_names``; -1 after averaging over items
    participant_names: tuple[str, ...]  # of all participants
    item_names: tuple[str, ...]  # of all items (sets)
    ours_is_a: Bool[np.ndarray, " N"] | None = None  # whether ours was shown as A; ``None`` after averaging
    scale: Scale = Scale()  # the answer scale
    item_scenes: tuple[str, ...] = ()  # the scene of each item; empty if unknown
    item_styles: tuple[str, ...] = ()  # the style of each item; empty if unknown
    ratings: tuple[float, float] | None = None  # means of ours and theirs, if deviations are differences of ratings
    unit: Unit = "response"  # what one row is

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.deviations)

    @property
    def item_titles(self) -> tuple[str, ...]:
        """Display names of the items: scene and style where both are known."""
        known = self.item_scenes and self.item_styles
        return tuple(map(", ".join, zip(self.item_scenes, self.item_styles, strict=True))) if known else self.item_names

    @property
    def factors(self) -> dict[Population, Int[np.ndarray, " N"]]:
        """Level of every answer in each random factor; only factors with at least two levels.

        Scenes and styles count as random from :data:`MIN_LEVELS` levels, unless every item has a level of its own.
        """
        codes: dict[Population, np.ndarray] = {"participants": self.participants, "items": self.items}
        codes = {factor: np.unique(of, return_inverse=True)[1] for factor, of in (codes | self._shared).items()}
        num = {factor: level.max(initial=0) for factor, level in codes.items()}
        own = [factor for factor in self._shared if num[factor] == num["items"]]
        return {factor: level for factor, level in codes.items() if num[factor] and factor not in own}

    @property
    def _shared(self) -> dict[Population, np.ndarray]:
        """Scene and style of every answer, where enough of them were judged to count as random."""
        names: dict[Population, tuple[str, ...]] = {"scenes": self.item_scenes, "styles": self.item_styles}
        judged: dict[Population, np.ndarray] = {kind: np.array(own)[self.items] for kind, own in names.items() if own}
        return {factor: own for factor, own in judged.items() if len(np.unique(own)) >= MIN_LEVELS}

    @property
    def populations(self) -> tuple[Population, ...]:
        """What a test generalises to that treats every factor as random."""
        populations: list[Population] = [factor for factor in ("participants", "items") if factor in self.factors]
        if "items" in populations and self._shared:
            populations[-1:] = self._shared
        return tuple(populations)

    def at(self, unit: Unit) -> "Responses":
        """Mean deviation of each ``unit`` as one row; participants and items without answers are dropped."""
        if unit == self.unit:
            return self
        if self.unit != "response":
            raise ValueError(f"rows are one per {self.unit} already; average the responses by {unit} instead")
        by_person = unit == "participant"
        codes = self.participants if by_person else self.items
        present, code, counts = np.unique(codes, return_inverse=True, return_counts=True)
        means = (np.bincount(code, weights=self.deviations) / counts).round(12)  # equal means are equal
        absent = np.full(len(present), -1)
        people, items = (present, absent) if by_person else (absent, present)
        return replace(self, deviations=means, participants=people, items=items, ours_is_a=None, unit=unit)


@dataclass(frozen=True)
class TestResult:
    """Result of one test."""

    __test__: ClassVar[bool] = False  # pytest would collect the name

    unit: Unit  # what was counted as one observation
    statistic: float  # the test statistic; ``nan`` if the test is undefined
    pvalue: float  # 0 where it is below the smallest double, ``nan`` if the test is undefined
    alternative: str  # the alternative hypothesis
    estimate: float  # the preference, in ``estimate_unit``; negative means ours is preferred
    interval: tuple[float, float]  # of the estimate, one-sided if ``alternative`` is; ``nan`` if there is none
    n: int  # number of observations
    effect: float = math.nan  # a standardised effect, signed like the estimate unless it is a probability
    effect_name: str = ""  # such as ``cohens_d``
    effect_interval: tuple[float, float] = (math.nan, math.nan)  # confidence interval of the effect
    confidence: float = 0.95  # level of both intervals
    method: str = ""  # one line that says exactly what was computed
    note: str = ""  # a caveat for the reader; empty if there is none
    generalizes_to: tuple[Population, ...] = ()  # populations that the p-value generalises to
    estimate_unit: str = "points"  # ``points`` of the answer scale, or another unit

    @classmethod
    def untestable(cls, responses: Responses, *, reason: str, alternative: str, method: str = "") -> "TestResult":
        """A result without a p-value, with the reason in its note."""
        mean, nan = float(np.mean(responses.deviations)) if responses.count else math.nan, math.nan
        values = (responses.unit, nan, nan, alternative, mean, (nan, nan), responses.count)
        return cls(*values, method=method, note=reason)


class StudyTest(Pluggable, ABC):
    """A statistical test of one question.

    An ``alternative``, a ``confidence`` level and a ``seed`` are the same for all tests of an analysis: a constructor
    that names one of them is given it.

    Swapping ours and theirs (negating every deviation) negates the estimate. Answers that do not allow the test, such
    as those of one participant or without any variation, give :meth:`TestResult.untestable`, never an error.
    """

    many = True
    runtime = ("alternative", "confidence", "seed")
    units: ClassVar[tuple[Unit, ...]]
    """Units it is run at; responses are averaged to each before the call."""

    @abstractmethod
    def __call__(self, responses: Responses) -> TestResult:
        """Test whether the answers differ from no preference."""


def generalization(unit: Unit) -> tuple[Population, ...]:
    """What a p-value generalises to that treats each ``unit`` as independent; nothing for single responses."""
    return {"response": (), "participant": ("participants",), "item": ("items",)}[unit]
