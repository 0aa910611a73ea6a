"""A study: what it asks, of how many and by which rules; and ``study.json``, which only the experimenter reads."""

import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

import msgspec

from anystyle.documents import fit, read_json
from anystyle.errors import did_you_mean
from anystyle.io.atomic import atomic_path
from anystyle.study.contract import Scale


class Question(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A question asked of every set.

    Args:
        name: As it stands in the answers.
        text: As participants read it; in a rating, ``{method}`` stands for A or B.
        labels: The answers from low to high, empty where only a number stands; the first of a comparison says that A is
            much better.
        kind: A ``comparison`` has one answer a set, on a scale from A to B; a ``rating`` has one for each method.
        low: The lowest score.
    """

    name: str
    text: str
    labels: tuple[str, ...]
    kind: Literal["comparison", "rating"] = "comparison"
    low: int = 1

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ValueError(f"question {self.name!r}: expected a name of letters, digits and '_'")
        if len(self.labels) < 2 or not (self.labels[0].strip() and self.labels[-1].strip()):
            raise ValueError(f"question {self.name}: expected at least two labels, the first and the last with words")

    @property
    def scale(self) -> Scale:
        """The answer scale."""
        return Scale(float(self.low), float(self.low + len(self.labels) - 1))

    @property
    def sides(self) -> tuple[str, ...]:
        """What a set is asked about: ``A`` and ``B`` each in a rating, ``""`` in a comparison."""
        return ("A", "B") if self.kind == "rating" else ("",)


class Demographic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A question about the participant, which nobody has to answer.

    Args:
        name: As it stands in the answers.
        text: As participants read it.
        choices: To choose from; empty for a free text.
    """

    name: str
    text: str
    choices: tuple[str, ...] = ()


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Who is left out, said before there are data.

    Args:
        failed_checks: Attention checks that a participant may fail; ``None`` leaves nobody out for them.
        straight_lining: Whether to leave out who gave one answer throughout; they are listed either way.
        missing_share: Of the answers that a participant was assigned, above which they are left out.
        min_seconds: A set that is answered faster is flagged; 0 flags none.
        fast_share: Of a participant's sets flagged so, above which they are left out.
    """

    failed_checks: int | None = 0
    straight_lining: bool = False
    missing_share: float = 0.5
    min_seconds: float = 0.0
    fast_share: float = 0.25

    def __post_init__(self) -> None:
        if not (0 <= self.missing_share <= 1 and 0 <= self.fast_share <= 1 and 0 <= self.min_seconds < 3600):
            raise ValueError("rules: expected shares from 0 to 1 and seconds from 0 to 3600")


class Plan(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The sizes, the words and the rules of a study.

    Args:
        title: Of the page.
        instructions: What participants read first; paragraphs are separated by blank lines.
        consent: What they agree to before the first set; empty for no such page.
        demographics: Asked before the first set.
        questions: Asked of every set.
        participants: How many there will be; even, so that every set is seen in both positions equally often.
        sets: How many sets each one judges; even, so that ours is A in half of them.
        pool: How many sets there are; 0 for as many as each one judges.
        views: Of each method in a set; more than one are shown as ``show`` says.
        show: All views in a ``grid``, one at a time as a ``flipbook``, or as a looping ``video``.
        frames_per_second: Of flip-books and videos.
        degraded: Attention checks: sets of which one side is spoilt, so that the answer is known.
        repeats: Attention checks: sets shown again with the sides exchanged.
        rules: Who is left out.
        id_parameters: Names in the page's address that hold a participant's id of elsewhere, such as ``PROLIFIC_PID``;
            with any, the server assigns whoever comes. Without, participants enter the design's codes.
        completion_url: Where participants go at the end; ``{code}`` stands for the code.
        completion_code: Shown at the end, once every answer has arrived.
        image_size: The longer side of every picture, in pixels.
        seed: Of every draw.
    """

    title: str = "Comparison of stylized images"
    instructions: str
    consent: str = ""
    demographics: tuple[Demographic, ...] = ()
    questions: tuple[Question, ...]
    participants: int = 40
    sets: int = 20
    pool: int = 0
    views: int = 1
    show: Literal["grid", "flipbook", "video"] = "grid"
    frames_per_second: int = 10
    degraded: int = 0
    repeats: int = 0
    rules: Rules = Rules()
    id_parameters: tuple[str, ...] = ()
    completion_url: str = ""
    completion_code: str = ""
    image_size: int = 512
    seed: int = 0

    def __post_init__(self) -> None:
        for name, count in (("participants", self.participants), ("sets", self.sets)):
            if count < 2 or count % 2:
                near = max(2, count - 1)
                raise ValueError(
                    f"{name}={count} cannot be balanced over the two positions; "
                    f"plan an even number, such as {near} or {near + 2}"
                )
        if self.pool and self.pool < self.sets:
            raise ValueError(f"pool={self.pool} has fewer sets than the {self.sets} that each one judges")
        for kind, entries in (("question", self.questions), ("demographic", self.demographics)):
            names = [entry.name for entry in entries]
            if len(set(names)) < len(names):
                raise ValueError(f"{kind}s are named {names}; expected different names")
        if not self.questions:
            raise ValueError("questions: expected at least one")
        if self.show == "grid" and self.views > 6:
            raise ValueError(f"views={self.views} are too many for a grid; plan at most 6, or show=flipbook or video")
        for name, value, low, high in (
            ("views", self.views, 1, 240),
            ("frames_per_second", self.frames_per_second, 1, 60),
            ("degraded", self.degraded, 0, self.sets // 2),
            ("repeats", self.repeats, 0, self.sets // 2),
            ("image_size", self.image_size, 64, 4096),
        ):
            if not low <= value <= high:
                raise ValueError(f"{name}={value}; expected {low} to {high}")
        if self.completion_url and urlsplit(self.completion_url).scheme not in ("http", "https"):
            raise ValueError(f"completion_url={self.completion_url!r}; expected an address that begins with https://")


def plan_from(options: Mapping[str, Any]) -> Plan:
    """A plan from a configuration's plain values, each of the right type.

    Raises:
        ValueError: An option is unknown or of the wrong type, or the plan cannot be balanced.
    """
    for name in options:
        if name not in Plan.__struct_fields__:
            names = ", ".join(sorted(Plan.__struct_fields__))
            raise ValueError(f"a study has no option {name!r}.{did_you_mean(name, names.split(', '))} Options: {names}")
    return fit(dict(options), Plan, source="the study's configuration", what="plan")


FILE, PICTURES = "study.json", "pictures"
_PICTURE = re.compile(r"[0-9a-f]{12}\.(jpg|mp4)")


class Item(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A set: one scene in one style by ours and by a baseline.

    Args:
        id: As it stands in the answers.
        scene: Its name.
        style: Its name.
        baseline: The other method.
        ours: The files in ``pictures/`` by ours, one a view or one video; their names tell nothing.
        theirs: The same of the other method.
        content: The same of the photographs.
        reference: The style's file, or empty.
        text: The style in words, or empty.
    """

    id: str
    scene: str
    style: str
    baseline: str
    ours: tuple[str, ...]
    theirs: tuple[str, ...]
    content: tuple[str, ...]
    reference: str = ""
    text: str = ""


class Check(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An attention check, which looks like any other set.

    Args:
        id: As it stands in the answers.
        kind: A ``degraded`` one shows intact files beside spoilt ones; a ``repeat`` shows a set again.
        of: The set that it is made of.
        ours: The intact files, or those by ours.
        theirs: The spoilt files, or those of the other method.
    """

    id: str
    kind: Literal["degraded", "repeat"]
    of: str
    ours: tuple[str, ...]
    theirs: tuple[str, ...]


class Participant(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What one participant sees.

    Args:
        id: The code to start with.
        order: Ids of sets and checks.
        ours_is_a: Ids of those in which ``ours`` (the intact files of a degraded check) is A.
    """

    id: str
    order: tuple[str, ...]
    ours_is_a: frozenset[str]


class Study(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """A designed study.

    Args:
        id: Made of everything else; answers of another study do not match it.
        ours: The method that the study is about.
        baselines: The others.
        plan: Sizes, words and rules.
        items: The sets.
        checks: The attention checks.
        participants: Who sees what.
    """

    id: str
    ours: str
    baselines: tuple[str, ...]
    plan: Plan
    items: tuple[Item, ...]
    checks: tuple[Check, ...]
    participants: tuple[Participant, ...]

    def __post_init__(self) -> None:
        for participant in self.participants:
            strange = [entry for entry in participant.order if entry not in self.shown]
            if strange:
                raise ValueError(f"participant {participant.id} is shown {strange[0]!r}, which there is none of")
        unknown = [check.of for check in self.checks if check.of not in self.shown]
        if unknown:
            raise ValueError(f"a check is of {unknown[0]!r}, which there is none of")
        for name in self.pictures:
            if not _PICTURE.fullmatch(name):
                raise ValueError(f"picture {name!r} has a name that is no file's")

    @cached_property
    def shown(self) -> dict[str, Item | Check]:
        """Every set and check by its id."""
        return {entry.id: entry for entry in (*self.items, *self.checks)}

    @property
    def pictures(self) -> tuple[str, ...]:
        """The names of all files in ``pictures/``, each once."""
        names = [name for entry in self.shown.values() for name in (*entry.ours, *entry.theirs)]
        names += [name for item in self.items for name in (*item.content, item.reference) if name]
        return tuple(dict.fromkeys(names))

    def participant(self, name: str) -> Participant | None:
        """What the participant of a name in the answers sees: ``P01-2`` took what ``P01`` had left."""
        return self._by_code.get(name.partition("-")[0])

    @cached_property
    def _by_code(self) -> dict[str, Participant]:
        return {participant.id: participant for participant in self.participants}

    def write(self, folder: Path) -> None:
        """Write ``study.json``."""
        with atomic_path(folder / FILE) as path:
            path.write_bytes(msgspec.json.format(msgspec.json.encode(self, order="deterministic"), indent=1) + b"\n")


def read_study(path: Path) -> Study:
    """Read a designed study from its folder or its ``study.json``.

    Raises:
        ValueError: There is none, or it is damaged.
    """
    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise ValueError(f"{path} holds no {FILE}; make one with `anystyle study design`")
    return read_json(file, Study, what="study; design it again")
