"""Tables of one row per person, as questionnaires export them, as rows of one answer each."""

import logging
import re
from collections.abc import Collection, Mapping
from pathlib import Path

from anystyle.errors import UserError, unknown
from anystyle_study.cells import plain
from anystyle_study.files import Sheet, read_sheet

log = logging.getLogger(__name__)

_KEY = ("column", "item", "question", "ours_is", "method", "side", "scene", "style", "expected", "comparison")
_KINDS = {"a": "side", "b": "side", "ours": "method", "theirs": "method"}
# `S1:style`, `S1 [style]`, `S1_style`, and with what was rated: `S1/content/A`
_HEADING = re.compile(
    r"(?P<item>.+?)(?:\s*[:/|\[]\s*|_)(?P<what>ours[_ ]is|[^:/|\[\]_]+?)\s*\]?"
    r"(?:(?:\s*[:/|\[]\s*|_)(?P<of>A|B|ours|theirs)\s*\]?)?",
    re.IGNORECASE,
)


def long_rows(sheet: Sheet, source: str, key: Path | None, items: Collection[str]) -> list[dict[str, str]]:
    """A row for each answer of each person; columns that are not understood become columns of every row.

    Columns say their item and question in their names, unless the table ``key`` says it of each ``column``, by name or
    number, with ``ours_is`` or ``method`` and the like. Without the design's ``items``, only items that say where ours
    was are answers. ``source`` is the name of the file, for messages.
    """
    names = [name.lower() if name.lower() in ("session", "comment") else name for name in sheet.names]
    facts: dict[str, dict[str, int]] = {}
    columns = _headings(names, items, facts) if key is None else _from_key(names, source, key)
    if not columns:
        raise UserError(
            f"{source}: no column says which set it is about; found were {', '.join(map(repr, names[:8]))}; name them "
            "ITEM:QUESTION, such as S1:style, beside S1:ours_is with A or B, or describe them with --columns FILE, a "
            "table of column, item, question, ours_is"
        )
    if "participant" not in names:
        log.warning("%s has no column participant: each row counts as another person", source)
    used = {*columns, *(index for each in facts.values() for index in each.values())}
    fields = dict.fromkeys([name for about in (*columns.values(), *facts.values()) for name in about], "")
    rows: list[dict[str, str]] = []
    for line, cells in zip(sheet.lines, sheet.rows, strict=True):
        shared = {name: cells[index] for index, name in enumerate(names) if index not in used}
        shared = {"participant": f"{source} row {line}"} | shared
        for index, about in columns.items():
            own = {name: cells[column] for name, column in facts.get(about["item"], {}).items()}
            where = {"": f"row {line}, column {names[index]!r}", "score": cells[index]}
            rows.append(shared | fields | about | own | where)
    return rows


def _headings(names: list[str], items: Collection[str], facts: dict[str, dict[str, int]]) -> dict[int, dict[str, str]]:
    """What each column of answers is about, by its name; columns with ``facts`` of an item go there."""
    columns: dict[int, dict[str, str]] = {}
    for index, name in enumerate(names):
        if found := _HEADING.fullmatch(name):
            item, what = found["item"].strip(), found["what"].strip()
            if (fact := what.lower().replace(" ", "_")) in ("ours_is", "expected", "comparison", "seconds"):
                facts.setdefault(item, {})[fact] = index
            else:
                kind = found["of"] or ""
                columns[index] = {"item": item, "question": what} | ({_KINDS[kind.lower()]: kind} if kind else {})
    placed = {item for item, each in facts.items() if {"ours_is", "expected"} & each.keys()}
    return {
        index: about
        for index, about in columns.items()
        if about["item"] in (items or placed) or (not items and "method" in about)
    }


def _from_key(names: list[str], source: str, key: Path) -> dict[int, dict[str, str]]:
    """What each column of answers is about, by a table of them."""
    sheet = read_sheet(key)
    heads = [name.lower().replace(" ", "_") for name in sheet.names]
    for name in heads:
        if name not in _KEY:
            raise UserError(f"{key.name}: {unknown('column', name, _KEY)}")
    if missing := [name for name in _KEY[:3] if name not in heads]:
        raise UserError(f"{key.name} lacks the column {missing[0]}; expected {', '.join(_KEY[:4])}")
    columns: dict[int, dict[str, str]] = {}
    for row in sheet.rows:
        about: Mapping[str, str] = dict(zip(heads, row, strict=True))
        wanted = about["column"]
        at = [index for index, name in enumerate(names) if plain(name) == plain(wanted)]
        if not at and wanted.isdecimal() and 0 < int(wanted) <= len(names):
            at = [int(wanted) - 1]
        if len(at) != 1:
            raise UserError(
                f"{key.name}: {source} has {len(at) or 'no'} columns {wanted!r}; expected one of "
                f"{', '.join(map(repr, names[:12]))}, or the number of a column"
            )
        columns[at[0]] = {name: cell for name, cell in about.items() if name != "column"}
    return columns
