"""A designed study: what ``study.json`` holds, and only the experimenter reads."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from anystyle.documents import read_json
from anystyle.io.atomic import atomic_path
from anystyle.study.plan import Plan

FILE, PICTURES = "study.json", "pictures"


@dataclass(frozen=True)
class Item:
    """A set: one scene in one style by ours and by a baseline.

    Args:
        id: As it stands in the answers.
        scene: Its name.
        style: Its name.
        baseline: The other method.
        ours: The name of the picture by ours, which tells nothing.
        theirs: The name of the other one.
        content: The name of the photograph's picture.
        reference: The name of the style's picture, or empty.
        text: The style in words, or empty.
    """

    id: str
    scene: str
    style: str
    baseline: str
    ours: str
    theirs: str
    content: str
    reference: str = ""
    text: str = ""


@dataclass(frozen=True)
class Check:
    """An attention check: a page that says what to answer.

    Args:
        id: As it stands in the answers.
        expected: The score to give.
    """

    id: str
    expected: int


@dataclass(frozen=True)
class Participant:
    """What one participant sees.

    Args:
        id: The code to start with.
        order: Ids of sets and checks.
        ours_is_a: Ids of the sets in which ours is A.
    """

    id: str
    order: tuple[str, ...]
    ours_is_a: frozenset[str]


@dataclass(frozen=True)
class Study:
    """A designed study.

    Args:
        id: Made of everything else; answers of another study do not match it.
        ours: The method that the study is about.
        baselines: The others.
        plan: Sizes and words.
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

    @property
    def pictures(self) -> tuple[str, ...]:
        """The names of all pictures, without a suffix."""
        names = [name for item in self.items for name in (item.ours, item.theirs, item.content, item.reference) if name]
        return tuple(dict.fromkeys(names))

    def write(self, folder: Path) -> None:
        """Write ``study.json``."""
        content = asdict(self)
        for participant in content["participants"]:
            participant["ours_is_a"] = sorted(participant["ours_is_a"])
        with atomic_path(folder / FILE) as path:
            path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_study(path: Path) -> Study:
    """Read a designed study from its folder or its ``study.json``.

    Raises:
        ValueError: There is none, or it is damaged.
    """
    file = path / FILE if path.is_dir() else path
    if not file.is_file():
        raise ValueError(f"{path} holds no {FILE}; make one with `anystyle study design`")
    study: Study = read_json(file, Study, what="study; design it again")
    known = {item.id for item in study.items} | {check.id for check in study.checks}
    for participant in study.participants:
        strange = set(participant.order) - known
        if strange:
            raise ValueError(
                f"{file} is no study: it shows participant {participant.id} {sorted(strange)[0]!r}, which there is none of"
            )
    for name in study.pictures:
        if not name.isalnum():
            raise ValueError(f"{file} is no study: it has a picture {name!r}, a name that is no file's")
    return study
