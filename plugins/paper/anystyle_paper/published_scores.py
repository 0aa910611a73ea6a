"""Scores that papers printed, each with the table that it stands in and its source."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import msgspec

from anystyle.errors import UserError
from anystyle.io.documents import read_json

BUNDLED = Path(__file__).with_name("published.json")
PAPER = "anystyle"
"""The source of the paper's own tables, by its key in the file."""


@dataclass(frozen=True)
class PublishedScore:
    """One cell of a paper's table; ``known_as`` is the method's name in the paper's other tables.

    The scene is empty for all scenes; values are numbers: times in seconds, properties 1 or 0.
    """

    method: str
    scene: str
    score: str
    value: float
    printed: str
    table: str
    source: str
    known_as: str
    origin: str = ""
    mark: str = ""


class _Row(msgspec.Struct):
    """A method's row of a table: for each score its cells by scene, as printed."""

    method: str
    source: str
    table: str
    scores: dict[str, dict[str, str | float]]
    marks: dict[str, dict[str, str]] = {}
    family: str | None = None
    origin: str | None = None


class _PublishedFile(msgspec.Struct):
    sources: dict[str, str]
    rows: list[_Row]
    aliases: dict[str, str] = {}
    better: dict[str, str] = {}


@lru_cache(1)
def _bundled() -> _PublishedFile:
    return read_json(BUNDLED, _PublishedFile)


def tables() -> dict[str, list[str]]:
    """The scores of each table of the AnyStyle paper, by the table's name."""
    rows = [row for row in _bundled().rows if row.source == PAPER]
    return {
        name: list(dict.fromkeys(score for row in rows if row.table == name for score in row.scores))
        for name in dict.fromkeys(row.table for row in rows)
    }


def better() -> dict[str, str]:
    """``higher`` or ``lower`` for each score of the tables that has a direction."""
    return dict(_bundled().better)


def load(more: Sequence[Path] = ()) -> list[PublishedScore]:
    """The scores that come with the package, and those of further JSON files of the same form."""
    scores = _cells(_bundled())
    for path in more:
        what = f"file of published scores, with 'sources' and 'rows' as in {BUNDLED.name}"
        stored = read_json(path, _PublishedFile, what=what)
        try:
            scores += _cells(stored)
        except (KeyError, ValueError) as error:  # an unknown source, or a text that is not a number
            raise UserError(f"{path} is not a {what} ({str(error)[:80]})") from None
    return scores


def _cells(stored: _PublishedFile) -> list[PublishedScore]:
    return [
        PublishedScore(
            method=row.method,
            scene=scene,
            score=score,
            value=_value(str(printed)),
            printed=str(printed),
            table=row.table,
            source=stored.sources[row.source],
            known_as=stored.aliases.get(row.method, row.method),
            origin="; ".join(filter(None, (row.family, row.origin))),
            mark=row.marks.get(score, {}).get(scene, ""),
        )
        for row in stored.rows
        for score, cells in row.scores.items()
        for scene, printed in cells.items()
    ]


def _value(printed: str) -> float:
    if printed in ("✓", "✗"):
        return float(printed == "✓")
    value = float(printed.rstrip("sm ")) * (60.0 if printed.endswith("m") else 1.0)
    if not math.isfinite(value):
        raise ValueError(f"{printed} is not a number")
    return value
