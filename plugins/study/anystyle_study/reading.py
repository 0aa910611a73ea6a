"""Answers from CSV, JSON or SQLite files, one answer a row, as the form stores them or from any other form.

The form's answers do not say where ours was; the design does. A table from elsewhere says it in ``ours_is`` (A or B),
or whose rating it is in ``method`` (ours or theirs).
"""

import csv
import io
import math
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from anystyle.errors import UserError
from anystyle.io.documents import fit, parse_json, read_bytes
from anystyle_study.protocol import Check, Study

REQUIRED = ("participant", "item", "question", "score")  # the columns that every table has
_OPTIONAL = ("study", "side", "ours_is", "method", "scene", "style", "expected", "comparison", "seconds", "comment")
_BOOKKEEPING = ("time", "session", "device", "revision", "received", "id")
_KNOWN = frozenset((*REQUIRED, *_OPTIONAL, *_BOOKKEEPING))
_SUFFIXES = (".csv", ".tsv", ".json", ".sqlite", ".sqlite3", ".db")
_MAX_BYTES = 256 << 20
_Row = dict[str, str]


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
    comments: tuple[tuple[str, str], ...] = ()  # free texts, each with its participant
    unused: tuple[str, ...] = ()  # columns that are not understood, and were ignored
    sources: tuple[str, ...] = ()  # names of the files


def read_responses(paths: Sequence[Path], study: Study | None = None) -> Records:
    """Read answers from files and folders of files; the form's own answers need the study's design."""
    files = [file for path in paths for file in _files(path)]
    if not files:
        raise UserError("no file of responses is given; name CSV, JSON or SQLite files, or a folder of them")
    tables = {file: _rows(file) for file in files}
    answers = [answer for file, rows in tables.items() for answer in _answers(rows, file.name, study)]
    people = dict.fromkeys(answer.participant for answer in answers)
    assigned = {} if study is None else {person: study.num_items(person) for person in people}
    rows = [row for table in tables.values() for row in table]
    return Records(
        answers=tuple(answers),
        assigned={person: count for person, count in assigned.items() if count},
        comments=tuple(dict.fromkeys((row["participant"], row["comment"]) for row in rows if row.get("comment"))),
        unused=tuple(dict.fromkeys(name for table in tables.values() for name in table[0] if name not in _KNOWN)),
        sources=tuple(file.name for file in files),
    )


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file())
    if not files:
        raise UserError(f"{path} holds no responses; expected files that end in {', '.join(_SUFFIXES)}")
    return files


def _rows(path: Path) -> list[_Row]:
    """The rows of a file, all with the same columns."""
    content = read_bytes(path, most=_MAX_BYTES, what="table of answers")
    if content.startswith(b"SQLite format 3\0"):
        names, rows = _sqlite_table(path)
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise UserError(f"{path.name} is not UTF-8 text (at byte {error.start}); save it as CSV UTF-8") from None
        if not text.strip():
            raise UserError(f"{path.name} is empty; expected a table with the columns {', '.join(REQUIRED)}")
        if "\0" in text:
            raise UserError(f"{path.name} holds binary data; expected CSV, JSON or SQLite")
        is_json = path.suffix.lower() == ".json" or text.lstrip()[0] in "[{"
        names, rows = (_json_table if is_json else _csv_table)(text, path.name)
    names = [name.strip().lower() if name.strip().lower() in _KNOWN else name.strip() for name in names]
    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise UserError(f"{path.name} has the column {duplicates[0]!r} twice; expected each name once")
    missing = [name for name in REQUIRED if name not in names]
    if missing:
        raise UserError(
            f"{path.name} lacks the column{'s' * (len(missing) > 1)} {', '.join(missing)}; it has "
            f"{', '.join(names[:12])}; expected one answer a row, in {', '.join(REQUIRED)}"
        )
    cells = ((str("" if cell is None else cell).strip() for cell in row) for row in rows)
    table = [dict(zip(names, row, strict=True)) for row in cells]
    if not table:
        raise UserError(f"{path.name} holds a header and no answers; expected one answer a row")
    return table


def _csv_table(text: str, source: str) -> tuple[list[str], list[list[str]]]:
    header = text.lstrip("\r\n").split("\n", 1)[0]
    delimiter = max(",;\t", key=header.count)
    try:
        names, *rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) if any(row)]
    except csv.Error as error:
        raise UserError(f"{source} is no CSV table: {error}") from None
    for line, row in enumerate(rows, start=2):
        if len(row) != len(names):
            raise UserError(f"{source}, row {line} has {len(row)} cells where the header has {len(names)}")
    return names, rows


def _json_table(text: str, source: str) -> tuple[list[str], Iterable[Sequence[Any]]]:
    what, cell = (
        "list of answers, or an object with such a list named 'responses'",
        dict[str, str | float | bool | None],
    )
    data: Any = parse_json(text, list[cell] | dict[str, Any], source=source, what=what)
    head: dict[str, Any] = data if isinstance(data, dict) else {"responses": data}
    answers: list[dict[str, Any]] = fit(head.get("responses"), list[cell], source=source, what=what)
    shared = {name: head[name] for name in ("study", "participant", "comment") if name in head}
    rows = [shared | row for row in answers]
    names = list(dict.fromkeys(str(name) for row in rows for name in row))
    return names, [[row.get(name) for name in names] for row in rows]


def _sqlite_table(path: Path) -> tuple[list[str], list[Sequence[Any]]]:
    """The table ``responses``, or the first one with participants and items."""
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            kinds = "SELECT name FROM sqlite_master WHERE type IN ('table', 'view')"
            tables = [str(name) for (name,) in database.execute(kinds)]
            for table in sorted(tables, key=lambda name: (name != "responses", name)):
                quoted = '"' + table.replace('"', '""') + '"'
                cursor = database.execute(f"SELECT * FROM {quoted}")
                names = [column[0] for column in cursor.description]
                if {"participant", "item"} <= {name.strip().lower() for name in names}:
                    return names, cursor.fetchall()
    except (sqlite3.Error, UnicodeError, OverflowError) as error:
        raise UserError(f"{path.name} is no readable SQLite file: {error}") from None
    raise UserError(f"{path.name} has no table with the columns {', '.join(REQUIRED)}; its tables are {tables[:12]}")


def _answers(rows: Sequence[_Row], source: str, study: Study | None) -> Iterable[Answer]:
    placed = "ours_is" in rows[0] or "method" in rows[0]
    if not placed and study is None:
        raise UserError(f"{source} does not say where ours was: give the design with --study, or add ours_is")
    for line, row in enumerate(rows, start=2):
        where = f"{source}, row {line}"
        for name in ("participant", "item", "question"):
            if not row[name]:
                raise UserError(f"{where}: {name} is empty; expected a name")
        expected = _number(row, "expected", where)
        method = _choice(row, "method", ("ours", "theirs"), where, optional=True)
        if placed or study is None:
            side = _choice(row, "ours_is", ("A", "B"), where, optional=bool(method) or not math.isnan(expected))
            about: dict[str, Any] = {name: row.get(name, "") for name in ("comparison", "scene", "style")}
            about |= {"ours_is_a": side == "A", "method": method}
        else:
            about = _designed(row, where, source, study)
        yield Answer(
            participant=row["participant"],
            item=row["item"],
            question=row["question"],
            score=_number(row, "score", where),
            expected=expected,
            seconds=_number(row, "seconds", where),
            **about,
        )


def _designed(row: _Row, where: str, source: str, study: Study) -> dict[str, Any]:
    """The design's facts about an answer of the form."""
    if row.get("study", "") not in ("", study.id):
        raise UserError(f"{source} holds answers to another study ({row['study']}, not {study.id})")
    person, name, side = row["participant"], row["item"], row.get("side", "")
    participant, shown = study.participant(person), study.shown.get(name)
    if participant is None or shown is None:
        what = f"participant {person!r}" if participant is None else f"item {name!r}"
        raise UserError(f"{where}: the design has no {what}")
    item = study.item(name)
    ours_is_a = name in participant.ours_is_a
    return {
        "ours_is_a": ours_is_a,
        "method": ("ours" if (side == "A") == ours_is_a else "theirs") if side else "",
        "check": shown.kind if isinstance(shown, Check) else "",
        "of": item.id,
        "comparison": item.baseline if len(study.baselines) > 1 else "",
        "scene": item.scene,
        "style": item.style,
    }


def _number(row: _Row, name: str, where: str) -> float:
    cell = row.get(name, "")
    try:
        return float(cell or "nan")
    except ValueError:
        raise UserError(f"{where}: {name} is {cell[:40]!r}; expected a number") from None


def _choice(row: _Row, name: str, choices: tuple[str, str], where: str, *, optional: bool) -> str:
    """A cell that is one of two words, in any case; an optional one may also be empty or anything else."""
    cell = row.get(name, "")
    word = next((choice for choice in choices if choice.lower() == cell.lower()), "")
    if not word and not (optional and (name == "ours_is" or not cell)):
        raise UserError(f"{where}: {name} is {cell[:40]!r}; expected {' or '.join(choices)}")
    return word
