"""Tables of text from CSV and JSON files, in the encodings and forms that people's programs save."""

import csv
import io
import json
import logging
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from anystyle.errors import UserError
from anystyle.io.documents import fit, parse_json, read_bytes

log = logging.getLogger(__name__)

_MAX_BYTES = 256 << 20


PEOPLE = (
    *("prolific_pid", "prolific_id", "participant_id", "participant.code", "subject", "subject_id"),
    *("worker_id", "workerid", "response_id", "responseid", "respondent_id", "participant_private_id"),
)
"""Columns by which other programs name people, of which the first counts that is there."""


class Sheet(NamedTuple):
    """A header, rows of as many cells, and the number of each row in the file."""

    names: list[str]
    rows: list[list[str]]
    lines: list[int]
    semicolons: bool  # whether semicolons separate the cells, as where numbers have a decimal comma


def read_sheet(path: Path) -> Sheet:
    """The table in a CSV or JSON file, without empty columns that have no name, and without Qualtrics' own rows.

    The column that names people is called ``participant``.
    """
    text = _decoded(read_bytes(path, most=_MAX_BYTES, what="table of answers"), path.name)
    if not text.strip():
        return Sheet([], [], [], False)
    if "\0" in text:
        raise UserError(f"{path.name} holds binary data; expected CSV or JSON")
    semicolons = False
    if path.suffix.lower() == ".json" or text.lstrip()[0] in "[{":
        names, rows = _json_table(text, path.name)
    else:
        names, rows, semicolons = _csv_table(text, path.name)
    table = [[str("" if cell is None else cell).strip() for cell in row] for row in rows]
    names = [name.strip() for name in names]
    kept = [index for index, name in enumerate(names) if name or any(row[index] for row in table)]
    names = _with_people([names[index] or f"column {index + 1}" for index in kept], path.name)
    filled = [(line, [row[index] for index in kept]) for line, row in enumerate(table, 2) if any(row)]
    answers = [filled[index] for index in _answers(names, [row for _, row in filled], path.name)]
    return Sheet(names, [row for _, row in answers], [line for line, _ in answers], semicolons)


def plain_name(name: str) -> str:
    """A column's name, whatever its case, spaces and dashes."""
    return re.sub(r"[\s-]+", "_", name.lower())


def _with_people(names: list[str], source: str) -> list[str]:
    """The names of columns, that of the people as ``participant``."""
    plain = list(map(plain_name, names))
    for name in ("participant", *PEOPLE):
        if plain.count(name) == 1:
            index = plain.index(name)
            if name != "participant":
                log.warning("%s: people are named by the column %s", source, names[index])
            return [*names[:index], "participant", *names[index + 1 :]]
    return names


def _answers(names: list[str], rows: list[list[str]], source: str) -> list[int]:
    """The rows that participants gave: not Qualtrics' texts of questions, import ids, previews and spam."""
    ids = [index for index, row in enumerate(rows[:2]) if any(cell.startswith('{"ImportId":') for cell in row)]
    first = ids[0] + 1 if ids else 0
    if ids:
        log.warning("%s: rows 2 to %d, Qualtrics' texts and import ids, are left out", source, first + 1)
    kinds = [index for index, name in enumerate(names) if plain_name(name) in ("status", "response_type")]
    tried = {"survey preview", "survey test", "spam", *(("1", "2", "8") if ids else ())}
    answers = [
        index for index in range(first, len(rows)) if not any(rows[index][column].lower() in tried for column in kinds)
    ]
    if previews := len(rows) - first - len(answers):
        log.warning("%s: %d previews of the survey are left out, or what Qualtrics takes for spam", source, previews)
    return answers


def _decoded(content: bytes, source: str) -> str:
    """Text in UTF-8, UTF-16 or UTF-32; other bytes are read as Windows-1252, and that is told."""
    if content.startswith((b"PK\3\4", b"\xd0\xcf\x11\xe0")):
        raise UserError(f"{source} is a workbook or an archive; save its sheet of answers as CSV UTF-8")
    encoding = json.detect_encoding(content)  # by a mark, or by the zeros in a plain header
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        wrong = f"{source} is not {encoding.removesuffix('-sig').upper()} text (at byte {error.start})"
        try:
            text = content.decode("cp1252") if encoding.startswith("utf-8") else ""
        except UnicodeDecodeError:
            text = ""
    if not text:
        raise UserError(f"{wrong}; save it as CSV UTF-8")
    word = re.findall(r"\w*[^\W\x00-\x7f]\w*|[^\x00-\x7f]", text)[0]
    log.warning("%s; it is read as Windows-1252, such as %r: if that is wrong, save it as CSV UTF-8", wrong, word)
    return text


def _csv_table(text: str, source: str) -> tuple[list[str], list[list[str]], bool]:
    """The cells between the delimiter that gives every row as many as the header, and whether it is a semicolon."""
    delimiters = ",;\t|"
    if told := re.match(r'"?sep=(.)"?[^\S\t]*[\r\n]+', text, re.IGNORECASE):  # Excel's own first line
        delimiters, text = told[1], text[told.end() :]
    try:
        tables = {mark: [*csv.reader(io.StringIO(text, newline=""), delimiter=mark)] for mark in delimiters}
    except csv.Error as error:
        raise UserError(f"{source} is not a CSV table: {error}") from None

    def fits(delimiter: str) -> tuple[bool, int]:
        header, *rows = [*map(len, filter(any, tables[delimiter]))] or [0]
        return header > 1 and {header}.issuperset(rows), header

    table = tables[delimiter := max(tables, key=fits)]
    first = next((index for index, row in enumerate(table) if any(row)), 0)
    names, rows = table[first], table[:first] + table[first + 1 :]
    for line, row in enumerate(rows, start=2):
        if any(row) and len(row) != len(names):
            raise UserError(f"{source}, row {line} has {len(row)} cells where the header has {len(names)}")
    return names, [row if any(row) else [""] * len(names) for row in rows], delimiter == ";"


def _json_table(text: str, source: str) -> tuple[list[str], Iterable[Sequence[Any]]]:
    what = "list of answers, or an object with such a list named 'responses'"
    cell = dict[str, str | float | bool | None]
    text = re.sub(r"(?<=[:,\[])\s*NaN(?=\s*[,}\]])", "null", text)  # as Python writes what is missing
    data: Any = parse_json(text, list[cell] | dict[str, Any], source=source, what=what)
    head: dict[str, Any] = data if isinstance(data, dict) else {"responses": data}
    shared = {name: head[name] for name in ("study", "participant", "comment") if name in head}
    rows = [shared | row for row in fit(head.get("responses"), list[cell], source=source, what=what)]
    names = list(dict.fromkeys(str(name) for row in rows for name in row))
    return names, [[row.get(name) for name in names] for row in rows]
