"""A designed study: what ``study.json`` holds, and only the experimenter reads."""

import re
from functools import cached_property
from pathlib import Path
from typing import Literal

import msgspec

from anystyle.documents import read_json
from anystyle.io.atomic import atomic_path
from anystyle.study.plan import Plan

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
        for one in self.participants:
            strange = [entry for entry in one.order if entry not in self.shown]
            if strange:
                raise ValueError(f"participant {one.id} is shown {strange[0]!r}, which there is none of")
        unknown = [check.of for check in self.checks if check.of not in self.shown]
        if unknown:
            raise ValueError(f"a check is of {unknown[0]!r}, which there is none of")
        for name in self.pictures:
            if not _PICTURE.fullmatch(name):
                raise ValueError(f"picture {name!r} has a name that is no file's")

    @cached_property
    def shown(self) -> dict[str, Item | Check]:
        """Every set and check by its id."""
        return {one.id: one for one in (*self.items, *self.checks)}

    @property
    def pictures(self) -> tuple[str, ...]:
        """The names of all files in ``pictures/``, each once."""
        names = [name for one in self.shown.values() for name in (*one.ours, *one.theirs)]
        names += [name for item in self.items for name in (*item.content, item.reference) if name]
        return tuple(dict.fromkeys(names))

    def participant(self, name: str) -> Participant | None:
        """What the participant of a name in the answers sees: ``P01-2`` took what ``P01`` had left."""
        return self._by_code.get(name.partition("-")[0])

    @cached_property
    def _by_code(self) -> dict[str, Participant]:
        return {one.id: one for one in self.participants}

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
