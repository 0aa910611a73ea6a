"""Answers as they are read from any form."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Answer:
    """One answer and what it is about."""

    participant: str  # who answered
    item: str  # the set that was judged
    question: str  # the question's name
    score: float  # as it was given; ``nan`` if it is missing
    ours_is_a: bool = False  # whether ours (in a degraded check: the intact side) was shown as A
    method: str = ""  # whose rating it is, ``ours`` or ``theirs``; empty for a comparison
    expected: float = math.nan  # right answer of an attention check of another form; else ``nan``
    check: str = ""  # ``degraded`` or ``repeat`` for an attention check of the design; else empty
    of: str = ""  # the item that the check was made from
    comparison: str = ""  # the baseline, if there are several; else empty
    scene: str = ""  # of the item; empty if unknown
    style: str = ""  # of the item; empty if unknown
    seconds: float = math.nan  # time taken; ``nan`` if unknown
    source: str = ""  # the file, or the session in it, that has the answer

    @property
    def cell(self) -> tuple[str, ...]:
        """What it answers: a person has one answer of each."""
        return self.participant, self.item, self.question, self.comparison, self.method

    @property
    def given(self) -> tuple[float, bool]:
        """The answer: a score means another thing where ours was on the other side."""
        return self.score, self.ours_is_a

    @property
    def is_check(self) -> bool:
        """Whether it answers an attention check."""
        return bool(self.check) or not math.isnan(self.expected)


@dataclass(frozen=True)
class Records:
    """The answers of a study."""

    answers: tuple[Answer, ...]  # in the order of the files
    # number of items that each participant was to judge, where known
    assigned: Mapping[str, int] = field(default_factory=dict)
    unanswered: tuple[Answer, ...] = ()  # attention checks that participants were shown and that have no row
    comments: tuple[tuple[str, str], ...] = ()  # free texts, each with its participant
    unused: tuple[str, ...] = ()  # columns that are not understood, and were ignored
    sources: tuple[str, ...] = ()  # names of the files
