"""Answers from files: CSV, JSON or SQLite, long or wide, as they were collected."""

import csv
import io
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from anystyle.documents import fit, parse_json, read_bytes

LONG = ("participant", "item", "question", "score", "ours_is")
"""The columns of a long table: one answer a row."""

_OPTIONAL = ("expected", "comparison", "comment")
_BOOKKEEPING = ("seconds", "time", "session", "device", "revision", "received", "id")
_SUFFIXES = (".csv", ".tsv", ".json", ".sqlite", ".sqlite3", ".db")
_MAX_BYTES = 256 << 20
_MAX_STEPS = 20_000_000
"""What SQLite may do to read a table, in its own instructions: a view in a file may never end."""
_EVERY = 10_000
_MAX_CELL = 1 << 20
_Answer = dict[str, str | float | bool | None]


@dataclass(frozen=True)
class Records:
    """Answers as they were given, positions not yet undone.

    Args:
        participant: Who answered.
        item: What was judged.
        question: What was asked.
        score: ``nan`` where there is none.
        ours_is_a: Whether ours was shown as A; undefined for attention checks.
        expected: The right answer of an attention check; ``nan`` for all others.
        comparison: Which baseline ours was compared with, where there are several; else empty.
        comments: Free texts, each with its participant.
        unused: Columns that are not understood, and were left out.
        sources: The files.
    """

    participant: np.ndarray
    item: np.ndarray
    question: np.ndarray
    score: Float[np.ndarray, " N"]
    ours_is_a: Bool[np.ndarray, " N"]
    expected: Float[np.ndarray, " N"]
    comparison: np.ndarray
    comments: tuple[tuple[str, str], ...] = ()
    unused: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()

    def select(self, rows: Bool[np.ndarray, " N"] | Int[np.ndarray, " M"]) -> "Records":
        """Some of the answers, in the order asked for."""
        columns = ("participant", "item", "question", "score", "ours_is_a", "expected", "comparison")
        chosen: dict[str, Any] = {name: getattr(self, name)[rows] for name in columns}
        return Records(**chosen, comments=self.comments, unused=self.unused, sources=self.sources)


@dataclass(frozen=True)
class _Columns:
    """A file's table, column by column, as text."""

    names: tuple[str, ...]
    cells: Mapping[str, list[str]]
    source: str

    @property
    def count(self) -> int:
        return len(self.cells[self.names[0]]) if self.names else 0

    def get(self, name: str) -> list[str]:
        return self.cells.get(name) or [""] * self.count


def read_responses(paths: Sequence[Path]) -> Records:
    """Read answers from files and folders of files.

    Raises:
        ValueError: There is no file, one cannot be understood, or one holds no answers.
        OSError: A file cannot be read.
    """
    files = [file for path in paths for file in _files(path)]
    parts = [_records(_columns(file)) for file in files]
    if not parts:
        raise ValueError("no file of responses is given; name CSV, JSON or SQLite files, or a folder of them")
    return _joined(parts)


def _joined(parts: Sequence[Records]) -> Records:
    names = ("participant", "item", "question", "score", "ours_is_a", "expected", "comparison")
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Records(
        **columns,
        comments=tuple(comment for part in parts for comment in part.comments),
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


def _columns(path: Path) -> _Columns:
    content = read_bytes(path, most=_MAX_BYTES, what="table of answers")
    if content.startswith(b"SQLite format 3\0"):
        return _sqlite_columns(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name} is not UTF-8 text (at byte {error.start}); save it as CSV UTF-8") from None
    if not text.strip():
        raise ValueError(f"{path.name} is empty; expected a table with the columns {', '.join(LONG)}")
    if "\0" in text:
        raise ValueError(f"{path.name} holds binary data; expected CSV, JSON or SQLite")
    if path.suffix.lower() == ".json" or text.lstrip()[0] in "[{":
        return _json_columns(text, path.name)
    return _csv_columns(text, path.name)


def _csv_columns(text: str, source: str) -> _Columns:
    header = text.lstrip("\r\n").split("\n", 1)[0]
    delimiter = max(",;\t", key=header.count)
    try:
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), delimiter=delimiter) if any(row)]
    except csv.Error as error:
        raise ValueError(f"{source} is no CSV table: {error}") from None
    names = tuple(name.strip() for name in rows[0])
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise ValueError(f"{source}, row {line} has {len(row)} cells where the header has {len(names)}")
    columns = list(zip(*rows[1:], strict=True)) if len(rows) > 1 else [()] * len(names)
    return _checked(names, columns, source)


def _json_columns(text: str, source: str) -> _Columns:
    what = "list of answers, or an object with such a list named 'responses'"
    data: list[_Answer] | dict[str, Any] = parse_json(text, list[_Answer] | dict[str, Any], source=source, what=what)
    rows: list[_Answer] = (
        fit(data["responses"], list[_Answer], source=source, what=what) if "responses" in data else data
    )
    names = tuple(dict.fromkeys(str(name) for row in rows for name in row))
    return _checked(names, [[_text(row.get(name)) for row in rows] for name in names], source)


def _sqlite_columns(path: Path) -> _Columns:
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
                names = tuple(column[0] for column in cursor.description)
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


def _checked(names: tuple[str, ...], columns: Iterable[Sequence[str]], source: str) -> _Columns:
    lowered = tuple(name.lower() if name.lower() in (*LONG, *_OPTIONAL, *_BOOKKEEPING) else name for name in names)
    twice = sorted({name for name in lowered if lowered.count(name) > 1})
    if twice:
        raise ValueError(f"{source} has the column {twice[0]!r} twice; expected each name once")
    cells = {name: [cell.strip() for cell in column] for name, column in zip(lowered, columns, strict=True)}
    table = _Columns(lowered, cells, source)
    if not table.count:
        raise ValueError(f"{source} holds a header and no answers; expected one answer a row")
    return table


def _records(table: _Columns) -> Records:
    if "score" in table.names or "question" in table.names:
        missing = [name for name in LONG if name not in table.names]
        if missing:
            raise ValueError(
                f"{table.source} lacks the column{'s' * (len(missing) > 1)} {', '.join(missing)}; it has "
                f"{', '.join(table.names)}; expected {', '.join(LONG)}"
            )
        return _long(table)
    if {"participant", "item", "ours_is"} <= set(table.names):
        return _wide_by_item(table)
    if "participant" in table.names and any(name.endswith(":ours_is") for name in table.names):
        return _wide_by_participant(table)
    raise ValueError(
        f"{table.source} has the columns {', '.join(table.names[:12])}; expected {', '.join(LONG)}, or a wide table "
        "with participant, item, ours_is and a column a question"
    )


def _long(table: _Columns, unused: tuple[str, ...] = ()) -> Records:
    known = (*LONG, *_OPTIONAL, *_BOOKKEEPING)
    expected = _numbers(table.get("expected"), table.source, "expected")
    participant = _names(table.get("participant"), table.source, "participant")
    comments = zip(table.get("participant"), table.get("comment"), strict=True)
    return Records(
        participant=participant,
        item=_names(table.get("item"), table.source, "item"),
        question=_names(table.get("question"), table.source, "question"),
        score=_numbers(table.get("score"), table.source, "score"),
        ours_is_a=_positions(table.get("ours_is"), ~np.isnan(expected), table.source),
        expected=expected,
        comparison=np.array(table.get("comparison")),
        comments=tuple(dict.fromkeys(pair for pair in comments if pair[1])),
        unused=unused + tuple(name for name in table.names if name not in known),
        sources=(table.source,),
    )


def _wide_by_item(table: _Columns) -> Records:
    """One row a participant and item, one column a question."""
    fixed = ("participant", "item", "ours_is", *_OPTIONAL)
    remaining = [name for name in table.names if name not in (*fixed, *_BOOKKEEPING)]
    questions = [name for name in remaining if _is_numeric(table.cells[name])]
    if not questions:
        raise ValueError(f"{table.source} has no column of scores beside {', '.join(table.names)}")
    cells = {name: table.get(name) * len(questions) for name in fixed if name in table.names and name != "comment"}
    cells["comment"] = table.get("comment") + [""] * (table.count * (len(questions) - 1))
    cells["question"] = [name for name in questions for _ in range(table.count)]
    cells["score"] = [cell for name in questions for cell in table.cells[name]]
    unused = tuple(name for name in remaining if name not in questions)
    return _long(_Columns(tuple(cells), cells, table.source), unused)


def _wide_by_participant(table: _Columns) -> Records:
    """One row a participant, columns ``ITEM:QUESTION`` and ``ITEM:ours_is``."""
    cells: dict[str, list[str]] = {name: [] for name in LONG}
    unused = [name for name in table.names if ":" not in name and name not in ("participant", *_BOOKKEEPING)]
    for name in table.names:
        item, colon, question = name.rpartition(":")
        if not colon or question == "ours_is":
            continue
        if f"{item}:ours_is" not in table.names:
            raise ValueError(f"{table.source} has the column {name!r} and no {item + ':ours_is'!r}; add it")
        cells["participant"] += table.get("participant")
        cells["item"] += [item] * table.count
        cells["question"] += [question] * table.count
        cells["score"] += table.get(name)
        cells["ours_is"] += table.get(f"{item}:ours_is")
    return _long(_Columns(LONG, cells, table.source), tuple(unused))


def _is_numeric(cells: Sequence[str]) -> bool:
    try:
        return any(cells) and all(np.isfinite(float(cell)) for cell in cells if cell)
    except ValueError:
        return False


def _names(cells: Sequence[str], source: str, column: str) -> np.ndarray:
    if not all(cells):
        row = next(index for index, cell in enumerate(cells, start=2) if not cell)
        raise ValueError(f"{source}, row {row}: {column} is empty; expected a name")
    return np.array(cells)


def _numbers(cells: Sequence[str], source: str, column: str) -> np.ndarray:
    try:
        return np.array([cell or "nan" for cell in cells], dtype=float)
    except ValueError:
        for row, cell in enumerate(cells, start=2):
            try:
                float(cell or "nan")
            except ValueError:
                raise ValueError(f"{source}, row {row}: {column} is {cell[:40]!r}; expected a number") from None
        raise


def _positions(cells: Sequence[str], optional: np.ndarray, source: str) -> np.ndarray:
    upper = np.char.upper(np.array(cells))
    wrong = np.flatnonzero(~np.isin(upper, ["A", "B"]) & ~optional)
    if len(wrong):
        cell = cells[int(wrong[0])]
        raise ValueError(f"{source}, row {int(wrong[0]) + 2}: ours_is is {cell[:40]!r}; expected A or B")
    return upper == "A"
