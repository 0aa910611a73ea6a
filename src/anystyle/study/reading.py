"""Answers from files: CSV, JSON or SQLite, one answer a row, as the form keeps them or as anybody else does.

The form's answers do not say where ours was: that is undone here, from the design. A table of another form says it in
``ours_is`` (A or B), and whose rating it is in ``method`` (ours or theirs).
"""

import csv
import io
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from anystyle.documents import fit, parse_json, read_bytes
from anystyle.study.protocol import Check, Item, Study

LONG = ("participant", "item", "question", "score")
"""The columns that every table has."""

_OPTIONAL = ("study", "side", "ours_is", "method", "scene", "style", "expected", "comparison", "seconds", "comment")
_BOOKKEEPING = ("time", "session", "device", "revision", "received", "id")
_KNOWN = frozenset((*LONG, *_OPTIONAL, *_BOOKKEEPING))
_SUFFIXES = (".csv", ".tsv", ".json", ".sqlite", ".sqlite3", ".db")
_MAX_BYTES = 256 << 20
_MAX_STEPS = 20_000_000
"""What SQLite may do to read a table, in its own instructions: a view in a file may never end."""
_EVERY = 10_000
_MAX_CELL = 1 << 20
_Answer = dict[str, str | float | bool | None]


@dataclass(frozen=True)
class Records:
    """Answers, each with what it is about; the scores as they were given.

    Args:
        participant: Who answered.
        item: What was judged.
        question: What was asked.
        score: ``nan`` where there is none.
        ours_is_a: Whether ours (of a degraded check: what is intact) was shown as A.
        method: Whose rating it is, ``ours`` or ``theirs``; empty for a comparison.
        expected: The right answer of an attention check of another form; else ``nan``.
        check: ``degraded`` or ``repeat`` for an attention check of the design; else empty.
        of: The item that a check was made of.
        comparison: Which baseline ours was compared with, where there are several; else empty.
        scene: The item's; empty where it is not known.
        style: The item's; empty where it is not known.
        seconds: What the answer took; ``nan`` where it is not known.
        assigned: How many items each participant was to judge, where that is known.
        comments: Free texts, each with its participant.
        unused: Columns that are not understood, and were left out.
        sources: The files.
    """

    participant: np.ndarray
    item: np.ndarray
    question: np.ndarray
    score: Float[np.ndarray, " N"]
    ours_is_a: Bool[np.ndarray, " N"]
    method: np.ndarray
    expected: Float[np.ndarray, " N"]
    check: np.ndarray
    of: np.ndarray
    comparison: np.ndarray
    scene: np.ndarray
    style: np.ndarray
    seconds: Float[np.ndarray, " N"]
    assigned: Mapping[str, int] = field(default_factory=dict)
    comments: tuple[tuple[str, str], ...] = ()
    unused: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()

    def select(self, rows: Bool[np.ndarray, " N"] | Int[np.ndarray, " M"]) -> "Records":
        """Some of the answers, in the order asked for."""
        columns: dict[str, Any] = {name: column[rows] for name, column in vars(self).items() if _is_column(column)}
        return replace(self, **columns)


def _is_column(value: object) -> bool:
    return isinstance(value, np.ndarray)


@dataclass(frozen=True)
class _Table:
    """A file's table, column by column, as text."""

    cells: Mapping[str, list[str]]
    source: str

    @property
    def count(self) -> int:
        return len(next(iter(self.cells.values()), ()))

    def get(self, name: str) -> list[str]:
        return self.cells.get(name) or [""] * self.count


def read_responses(paths: Sequence[Path], study: Study | None = None) -> Records:
    """Read answers from files and folders of files; the form's own answers need the study's design.

    Raises:
        ValueError: There is no file, one cannot be understood, is of another study, or holds no answers.
        OSError: A file cannot be read.
    """
    files = [file for path in paths for file in _files(path)]
    parts = [_records(_table(file), study) for file in files]
    if not parts:
        raise ValueError("no file of responses is given; name CSV, JSON or SQLite files, or a folder of them")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name, column in vars(parts[0]).items()
        if _is_column(column)
    }
    return Records(
        **columns,
        assigned={person: count for part in parts for person, count in part.assigned.items()},
        comments=tuple(dict.fromkeys(comment for part in parts for comment in part.comments)),
        unused=tuple(dict.fromkeys(name for part in parts for name in part.unused)),
        sources=tuple(source for part in parts for source in part.sources),
    )


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file())
    if not files:
        raise ValueError(f"{path} holds no responses; expected files that end in {', '.join(_SUFFIXES)}")
    return files


def _table(path: Path) -> _Table:
    content = read_bytes(path, most=_MAX_BYTES, what="table of answers")
    if content.startswith(b"SQLite format 3\0"):
        return _sqlite_table(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name} is not UTF-8 text (at byte {error.start}); save it as CSV UTF-8") from None
    if not text.strip():
        raise ValueError(f"{path.name} is empty; expected a table with the columns {', '.join(LONG)}")
    if "\0" in text:
        raise ValueError(f"{path.name} holds binary data; expected CSV, JSON or SQLite")
    if path.suffix.lower() == ".json" or text.lstrip()[0] in "[{":
        return _json_table(text, path.name)
    return _csv_table(text, path.name)


def _csv_table(text: str, source: str) -> _Table:
    header = text.lstrip("\r\n").split("\n", 1)[0]
    delimiter = max(",;\t", key=header.count)
    try:
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) if any(row)]
    except csv.Error as error:
        raise ValueError(f"{source} is no CSV table: {error}") from None
    names = [name.strip() for name in rows[0]]
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise ValueError(f"{source}, row {line} has {len(row)} cells where the header has {len(names)}")
    return _checked(names, list(zip(*rows[1:], strict=True)) if len(rows) > 1 else [()] * len(names), source)


def _json_table(text: str, source: str) -> _Table:
    what = "list of answers, or an object with such a list named 'responses'"
    data: Any = parse_json(text, list[_Answer] | dict[str, Any], source=source, what=what)
    head: dict[str, Any] = data if isinstance(data, dict) else {"responses": data}
    answers: list[_Answer] = fit(head.get("responses"), list[_Answer], source=source, what=what)
    shared = {name: head[name] for name in ("study", "participant", "comment") if name in head}
    rows = [shared | row for row in answers]
    names = list(dict.fromkeys(str(name) for row in rows for name in row))
    return _checked(names, [[_text(row.get(name)) for row in rows] for name in names], source)


def _sqlite_table(path: Path) -> _Table:
    steps = 0

    def tick() -> bool:
        nonlocal steps
        steps += 1
        return steps * _EVERY > _MAX_STEPS

    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            database.set_progress_handler(tick, _EVERY)
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_CELL)
            kinds = "SELECT name FROM sqlite_master WHERE type IN ('table', 'view')"
            tables = [str(name) for (name,) in database.execute(kinds)]
            for table in sorted(tables, key=lambda name: (name != "responses", name)):
                quoted = '"' + table.replace('"', '""') + '"'
                cursor = database.execute(f"SELECT * FROM {quoted}")
                names = [column[0] for column in cursor.description]
                if {"participant", "item"} <= {name.strip().lower() for name in names}:
                    rows = cursor.fetchall()
                    columns = [[_text(row[index]) for row in rows] for index in range(len(names))]
                    return _checked(names, columns, path.name)
    except (sqlite3.Error, UnicodeError, OverflowError) as error:
        reason = "a view in it does not end" if steps * _EVERY > _MAX_STEPS else error
        raise ValueError(f"{path.name} is no readable SQLite file: {reason}") from None
    raise ValueError(f"{path.name} has no table with the columns {', '.join(LONG)}; its tables are {tables[:12]}")


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _checked(names: Sequence[str], columns: Iterable[Sequence[str]], source: str) -> _Table:
    canonical_names = [name.lower() if name.lower() in _KNOWN else name for name in names]
    duplicates = sorted({name for name in canonical_names if canonical_names.count(name) > 1})
    if duplicates:
        raise ValueError(f"{source} has the column {duplicates[0]!r} twice; expected each name once")
    missing = [name for name in LONG if name not in canonical_names]
    if missing:
        raise ValueError(
            f"{source} lacks the column{'s' * (len(missing) > 1)} {', '.join(missing)}; it has "
            f"{', '.join(names[:12])}; expected one answer a row, in {', '.join(LONG)}"
        )
    cells = {name: [cell.strip() for cell in column] for name, column in zip(canonical_names, columns, strict=True)}
    table = _Table(cells, source)
    if not table.count:
        raise ValueError(f"{source} holds a header and no answers; expected one answer a row")
    return table


def _records(table: _Table, study: Study | None) -> Records:
    expected = _numbers(table, "expected")
    participant, item = _names(table, "participant"), _names(table, "item")
    comments = zip(table.get("participant"), table.get("comment"), strict=True)
    method = _choices(table, "method", "ours or theirs", np.array(table.get("method")) == "")
    if "ours_is" in table.cells or "method" in table.cells:
        design: dict[str, Any] = {
            "ours_is_a": _choices(table, "ours_is", "A or B", ~np.isnan(expected) | (method != "")) == "A",
            "method": method,
            **{name: np.array(table.get(name)) for name in ("comparison", "scene", "style")},
            **dict.fromkeys(("check", "of"), np.full(table.count, "")),
        }
    elif study is None:
        raise ValueError(f"{table.source} does not say where ours was: give the design with --study, or add ours_is")
    else:
        design = _designed(table, study)
    return Records(
        participant=participant,
        item=item,
        question=_names(table, "question"),
        score=_numbers(table, "score"),
        expected=expected,
        seconds=_numbers(table, "seconds"),
        **design,
        comments=tuple(dict.fromkeys(pair for pair in comments if pair[1])),
        unused=tuple(name for name in table.cells if name not in _KNOWN),
        sources=(table.source,),
    )


def _designed(table: _Table, study: Study) -> dict[str, Any]:
    """What the design knows of each answer of the form."""
    strangers = sorted(set(table.get("study")) - {"", study.id})
    if strangers:
        raise ValueError(f"{table.source} holds answers to another study ({strangers[0]}, not {study.id})")
    items, sides = {item.id: item for item in study.items}, table.get("side")
    columns: dict[str, list[Any]] = {
        name: [] for name in ("ours_is_a", "method", "check", "of", "comparison", "scene", "style")
    }
    assigned: dict[str, int] = {}
    for row, (person, name) in enumerate(zip(table.get("participant"), table.get("item"), strict=True)):
        participant, shown = study.participant(person), study.shown.get(name)
        if participant is None or shown is None:
            what = f"participant {person!r}" if participant is None else f"item {name!r}"
            raise ValueError(f"{table.source}, row {row + 2}: the design has no {what}")
        if person not in assigned:
            assigned[person] = sum(entry in items for entry in participant.order)
        ours_is_a = name in participant.ours_is_a
        item: Item = items[shown.of] if isinstance(shown, Check) else shown
        columns["ours_is_a"].append(ours_is_a)
        columns["method"].append(("ours" if (sides[row] == "A") == ours_is_a else "theirs") if sides[row] else "")
        columns["check"].append(shown.kind if isinstance(shown, Check) else "")
        columns["of"].append(item.id)
        columns["comparison"].append(item.baseline if len(study.baselines) > 1 else "")
        columns["scene"].append(item.scene)
        columns["style"].append(item.style)
    return {**{name: np.array(cells) for name, cells in columns.items()}, "assigned": assigned}


def _names(table: _Table, column: str) -> np.ndarray:
    cells = table.get(column)
    if not all(cells):
        row = next(index for index, cell in enumerate(cells, start=2) if not cell)
        raise ValueError(f"{table.source}, row {row}: {column} is empty; expected a name")
    return np.array(cells)


def _numbers(table: _Table, column: str) -> np.ndarray:
    cells = table.get(column)
    try:
        return np.array([cell or "nan" for cell in cells], dtype=float)
    except ValueError:
        for row, cell in enumerate(cells, start=2):
            try:
                float(cell or "nan")
            except ValueError:
                raise ValueError(f"{table.source}, row {row}: {column} is {cell[:40]!r}; expected a number") from None
        raise


def _choices(table: _Table, column: str, choices: str, optional: Bool[np.ndarray, " N"]) -> np.ndarray:
    """The cells of a column in the case of ``choices``, which are "ONE or OTHER"; any cell where it is optional."""
    cells = np.array(table.get(column))
    cased = np.char.lower(cells) if choices.islower() else np.char.upper(cells)
    wrong = np.flatnonzero(~np.isin(cased, choices.split(" or ")) & ~optional)
    if len(wrong):
        row, cell = int(wrong[0]) + 2, str(cells[wrong[0]])[:40]
        raise ValueError(f"{table.source}, row {row}: {column} is {cell!r}; expected {choices}")
    return cased
