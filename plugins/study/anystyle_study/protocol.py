"""The plan of a study (questions, sizes, exclusion rules) and the designed study, ``study.json``."""

import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from anystyle.errors import UserError, check_known
from anystyle.io.documents import fit, read_json
from anystyle.ranges import Count, Fraction, Range
from anystyle_study.contract import Alternative, Scale


class Question(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A question asked of every set."""

    name: str  # column value in the answers
    text: str  # shown to participants; in a rating, ``{method}`` stands for A or B
    labels: tuple[str, ...]  # from low (A is much better) to high; empty ones show a number only
    # a ``comparison`` has one answer per set, on a scale from A to B; a ``rating`` has one for each method
    kind: Literal["comparison", "rating"] = "comparison"
    low: int = 1  # the lowest score

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise UserError(f"question {self.name!r}: expected a name of letters, digits and '_'")
        if len(self.labels) < 2 or not (self.labels[0].strip() and self.labels[-1].strip()):
            raise UserError(f"question {self.name}: expected at least two labels, the first and the last with words")

    @property
    def scale(self) -> Scale:
        """The answer scale."""
        return Scale(float(self.low), float(self.low + len(self.labels) - 1))

    @property
    def sides(self) -> tuple[str, ...]:
        """Sides that a set is rated for: ``A`` and ``B``; only ``""`` in a comparison."""
        return ("A", "B") if self.kind == "rating" else ("",)


class Demographic(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An optional question about the participant."""

    name: str  # column value in the answers
    text: str  # shown to participants
    choices: tuple[str, ...] = ()  # choices; empty for a free text


class Rules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Exclusion rules, registered before there are data."""

    failed_checks: Count | None = 0  # attention checks that a participant may fail; ``None`` excludes nobody for them
    straight_lining: bool = False  # whether to exclude (not only list) participants who gave one answer throughout
    missing_share: Fraction = 0.5  # fraction of missing answers above which a participant is excluded
    min_seconds: Annotated[float, Range(ge=0, lt=3600)] = 0.0  # sets answered faster are listed; 0 lists none
    fast_share: Fraction = 0.25  # fraction of such sets above which a participant is excluded


class Plan(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Sizes, texts and rules of a study."""

    title: str = "Comparison of stylized images"  # title of the page
    instructions: str  # first text of the page; paragraphs are separated by blank lines
    consent: str = ""  # text to agree to before the first set; empty for no such page
    demographics: tuple[Demographic, ...] = ()  # asked before the first set
    questions: tuple[Question, ...]  # asked of every set
    participants: int = 40  # number of participants; even, so that every set is seen in both positions equally often
    sets: int = 20  # sets that each participant judges; even, so that ours is A in half of them
    pool: int = 0  # sets in all; 0 for as many as each participant judges
    # ``ours`` against each of the other methods, or ``all`` pairs of methods, of which each set shows one
    pairs: Literal["ours", "all"] = "ours"
    views: Annotated[int, Range(ge=1, le=240)] = 1  # views of each method in a set
    # all views in a ``grid``, one at a time as a ``flipbook``, or as a looping ``video``
    show: Literal["grid", "flipbook", "video"] = "grid"
    frames_per_second: Annotated[int, Range(ge=1, le=60)] = 10  # of flipbooks and videos
    degraded: int = 0  # attention checks in which one side is degraded, so that the answer is known
    repeats: int = 0  # attention checks that show a set again with the sides exchanged
    rules: Rules = Rules()  # exclusion rules
    alternative: Alternative = "two-sided"  # of all tests; ``less`` claims that ours is preferred
    image_size: Annotated[int, Range(ge=64, le=4096)] = 512  # longer side of every picture, in pixels
    seed: int = 0  # seed of all draws

    def __post_init__(self) -> None:
        for name, count in (("participants", self.participants), ("sets", self.sets)):
            if count < 2 or count % 2:
                even = f"plan an even number, such as {max(2, count - 1)} or {max(2, count - 1) + 2}"
                raise UserError(f"{name}={count} cannot be balanced over the two positions; {even}")
        if self.pool and self.pool < self.sets:
            raise UserError(f"pool={self.pool} has fewer sets than the {self.sets} that each one judges")
        for kind, entries in (("question", self.questions), ("demographic", self.demographics)):
            names = [entry.name for entry in entries]
            if len(set(names)) < len(names):
                raise UserError(f"{kind}s are named {names}; expected different names")
        if not self.questions:
            raise UserError("questions: expected at least one")
        if self.show == "grid" and self.views > 6:
            raise UserError(f"views={self.views} are too many for a grid; plan at most 6, or show=flipbook or video")
        for name, count in (("degraded", self.degraded), ("repeats", self.repeats)):
            if not 0 <= count <= self.sets // 2:
                raise UserError(f"{name}={count}; expected 0 to {self.sets // 2}")


def plan_defaults() -> dict[str, Any]:
    """The options of a plan with their defaults, as a configuration holds them."""
    values = ((option, option.default) for option in msgspec.structs.fields(Plan))
    return {option.name: "???" if option.required else msgspec.to_builtins(value) for option, value in values}


def plan_from(options: Mapping[str, Any]) -> Plan:
    """A plan from a configuration's plain values."""
    check_known("study option", options, Plan.__struct_fields__)
    return fit(dict(options), Plan, source="the study's configuration", what="plan")


FILE, PICTURES = "study.json", "pictures"
_PICTURE = re.compile(r"[0-9a-f]{12}\.(jpg|mp4)")


class Item(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A set: one scene in one style by ours and by a baseline, or by two methods of a study of all pairs."""

    id: str  # column value in the answers
    scene: str  # name of the scene
    style: str  # name of the style
    baseline: str  # the other method
    ours: tuple[str, ...]  # files in ``pictures/`` by ours, one per view or one video, under meaningless names
    theirs: tuple[str, ...]  # files of the other method
    content: tuple[str, ...]  # files of the photographs
    reference: str = ""  # file of the style, or empty
    text: str = ""  # the style in words, or empty
    method: str = ""  # the method that is ``ours`` in this set; empty for the study's


class Check(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An attention check, which looks like any other set."""

    id: str  # column value in the answers
    kind: Literal["degraded", "repeat"]  # intact files beside degraded ones, or a set again
    of: str  # the set that it was made from
    ours: tuple[str, ...]  # the intact files, or those by ours
    theirs: tuple[str, ...]  # the degraded files, or those of the other method


class Participant(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The sets that one participant sees."""

    id: str  # the code to enter
    order: tuple[str, ...]  # ids of sets and checks
    ours_is_a: frozenset[str]  # ids of those that show ``ours`` as A


class Study(msgspec.Struct, frozen=True, forbid_unknown_fields=True, dict=True):
    """A designed study."""

    id: str  # hash of everything else, pictures included; answers carry it
    ours: str  # the method that the study is about
    baselines: tuple[str, ...]  # the other methods
    plan: Plan  # sizes, texts and rules
    items: tuple[Item, ...]  # the sets
    checks: tuple[Check, ...]  # the attention checks
    participants: tuple[Participant, ...]  # the order and positions for each participant

    def __post_init__(self) -> None:
        unknown_ids = {entry for one in self.participants for entry in one.order} - self.shown.keys()
        unknown_ids |= {check.of for check in self.checks} - {item.id for item in self.items}
        if unknown_ids:
            raise UserError(f"it refers to a set {min(unknown_ids)!r} that it does not have")
        for name in self.pictures:
            if not _PICTURE.fullmatch(name):
                raise UserError(f"picture {name!r} has a name that is not a file name")

    @cached_property
    def shown(self) -> dict[str, Item | Check]:
        """Sets and checks by id."""
        return {entry.id: entry for entry in (*self.items, *self.checks)}

    def item(self, name: str) -> Item:
        """The set with an id, or the one that an attention check was made from."""
        entry = self.shown[name]
        return entry if isinstance(entry, Item) else self.item(entry.of)

    def methods(self, item: Item) -> tuple[str, str]:
        """The methods of a set, that which is ours in it first."""
        return item.method or self.ours, item.baseline

    @property
    def compared(self) -> str:
        """Which methods are compared, in words."""
        names = ", ".join(self.baselines)
        return f"every two of {self.ours}, {names}" if self.plan.pairs == "all" else f"{self.ours} against {names}"

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of all files in ``pictures/``, each once."""
        names = [name for entry in self.shown.values() for name in (*entry.ours, *entry.theirs)]
        names += [name for item in self.items for name in (*item.content, item.reference) if name]
        return tuple(dict.fromkeys(names))

    def participant(self, name: str) -> Participant | None:
        """The design's participant behind a name in the answers: ``P01-2`` is a second person in slot ``P01``."""
        code = name.partition("-")[0]
        return next((participant for participant in self.participants if participant.id == code), None)

    def shows(self, item: str, name: str) -> bool:
        """Whether a participant is shown a set or check."""
        participant = self.participant(name)
        return participant is not None and item in participant.order

    def num_items(self, name: str) -> int:
        """Number of sets, attention checks aside, that a participant is to judge; 0 for an unknown name."""
        return sum(self.shows(item.id, name) for item in self.items)

    def write(self, folder: Path) -> None:
        """Write ``study.json``."""
        text = msgspec.json.format(msgspec.json.encode(self, order="deterministic"), indent=1)
        (folder / FILE).write_bytes(text + b"\n")


def read_study(path: Path) -> Study:
    """Read a designed study from its folder or its ``study.json``."""
    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise UserError(f"{path} holds no {FILE}; make one with `anystyle study design`")
    return read_json(file, Study, what="study; design it again")
