"""Answers from CSV or JSON files, one answer per row, as the form stores them or from any other form.

The form's answers do not say where ours was; the design does. A table from elsewhere says it in ``ours_is`` (A or B),
or whose rating it is in ``method`` (ours or theirs).
"""

import logging
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from anystyle.errors import UserError, listing, unknown
from anystyle_study.answers import Answer, Records
from anystyle_study.cells import AnswerColumn, plain, scale_words
from anystyle_study.files import plain_name, read_sheet
from anystyle_study.people import check_names, check_sources
from anystyle_study.protocol import Check, Study
from anystyle_study.wide import long_rows

log = logging.getLogger(__name__)

REQUIRED = ("participant", "item", "question", "score")  # the columns that every table has
_OPTIONAL = ("study", "side", "ours_is", "method", "scene", "style", "expected", "comparison", "seconds", "comment")
_OPTIONAL += ("session",)
_KNOWN = frozenset(("", *REQUIRED, *_OPTIONAL, "time", "device", "revision", "received", "id"))
_SUFFIXES = (".csv", ".tsv", ".json")
_Row = dict[str, str]


def read_responses(
    paths: Iterable[Path],
    study: Study | None = None,
    *,
    labels: Mapping[str, float] = {},
    wide: bool = False,
    columns: Path | None = None,
    sessions: bool = False,
) -> Records:
    """Read answers from files and folders of files; the form's own answers need the study's design.

    ``labels`` are the scores of labels besides those of the design's questions. With ``wide``, a table may have one row
    per person; ``columns`` is a table that says what each of its columns is about, if their names do not. With
    ``sessions``, people of one name are different people in different files, and in different sessions by the column
    ``session``: the session becomes a part of their names.

    Raises:
        UserError: A file cannot be read, or people of one name gave different answers in different files or sessions,
            or the names of two differ in spelling alone.
    """
    files = [file for path in paths for file in _files(path)]
    if not files:
        raise UserError("no file of responses is given; name CSV or JSON files, or a folder of them")
    read = {file: _rows(file, wide=wide, columns=columns, study=study) for file in files}
    tables = {file: rows for file, rows in read.items() if rows[0]}
    if not tables:
        raise UserError(f"there are no answers in {listing([file.name for file in files])}; expected one per row")
    if len(tables) < len(read):
        log.warning("left out without answers: %s", listing([file.name for file in read if file not in tables]))
    if sessions:
        for file, (table, _) in tables.items():
            for row in table:
                parts = (row["participant"], file.stem if len(files) > 1 else "", row.get("session", ""))
                row["participant"] = "-".join(filter(None, parts))
    answers = [answer for file, table in tables.items() for answer in _answers(*table, file.name, study, labels)]
    check_names(answers)
    check_sources(answers)
    people = {answer.participant for answer in answers}
    assigned = {} if study is None else {person: count for person in people if (count := study.num_items(person))}
    rows = [row for table, _ in tables.values() for row in table]
    return Records(
        answers=tuple(answers),
        assigned=assigned,
        unanswered=() if study is None else tuple(_unanswered(answers, study)),
        comments=tuple(dict.fromkeys((row["participant"], row["comment"]) for row in rows if row.get("comment"))),
        unused=tuple(dict.fromkeys(name for table, _ in tables.values() for name in table[0] if name not in _KNOWN)),
        sources=tuple(file.name for file in tables),
    )


def _unanswered(answers: Sequence[Answer], study: Study) -> Iterator[Answer]:
    """The questions and sides of attention checks without a row that people were asked before their last answer."""
    checks = {check.id: check for check in study.checks}
    # A table may have none of a check at all.
    asked = dict.fromkeys((one.item, one.question, one.method) for one in answers if one.item in checks)
    for name in dict.fromkeys(answer.participant for answer in answers):
        given = {(one.item, one.question, one.method) for one in answers if one.participant == name}
        order = person.order if (person := study.participant(name)) else []
        last = max((order.index(item) for item, *_ in given if item in order), default=0)
        for item, question, method in (key for key in asked if key[0] in order[:last] and key not in given):
            yield Answer(name, item, question, math.nan, False, method, check=checks[item].kind, of=checks[item].of)


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    inside = [file for file in sorted(path.iterdir()) if file.is_file() and not file.name.startswith((".", "~$"))]
    files, taken = [file for file in inside if file.suffix.lower() in _SUFFIXES], ", ".join(_SUFFIXES)
    for file in inside:
        if file.suffix.lower() in (".txt", ".xls", ".xlsx", ".ods", ".zip"):
            log.warning("%s is not read; answers are in files that end in %s", file.name, taken)
    if not files:
        raise UserError(f"{path} holds no responses; expected files that end in {taken}")
    return files


def _rows(path: Path, *, wide: bool, columns: Path | None, study: Study | None) -> tuple[list[_Row], bool]:
    """The rows of a file, all with the same columns and their place under ``""``; whether semicolons part its cells."""
    sheet = read_sheet(path)
    if not sheet.rows:
        return [], sheet.semicolons
    names = [plain_name(name) if plain_name(name) in _KNOWN else name for name in sheet.names]
    missing = [name for name in REQUIRED if name not in names]
    if missing and (wide or columns):
        table = long_rows(sheet, path.name, columns, () if study is None else study.shown)
    elif missing:
        raise UserError(
            f"{path.name} lacks the {'columns' if len(missing) > 1 else 'column'} {', '.join(missing)}; it has "
            f"{', '.join(names[:12])}; expected one answer per row, in {', '.join(REQUIRED)} "
            "(one row per person: --wide)"
        )
    else:
        duplicates = sorted({name for name in names if names.count(name) > 1})
        if duplicates:
            raise UserError(f"{path.name} has the column {duplicates[0]!r} twice; expected each name once")
        lines = zip(sheet.lines, sheet.rows, strict=True)
        table = [{"": f"row {line}"} | dict(zip(names, row, strict=True)) for line, row in lines]
        if others := [row[""] for row in table if not _is_answer(row)]:
            told = "%s: %d rows without item and score are left out as other trials, such as %s"
            log.warning(told, path.name, len(others), others[0])
        table = list(filter(_is_answer, table))
    return table, sheet.semicolons


def _is_answer(row: _Row) -> bool:
    """Whether a row is about a set; an experiment's instructions and pauses are rows, too."""
    return bool(row["item"] or row["score"])


def _answers(
    rows: Sequence[_Row], semicolons: bool, source: str, study: Study | None, labels: Mapping[str, float]
) -> Iterable[Answer]:
    if study is None and "ours_is" not in rows[0] and "method" not in rows[0]:
        raise UserError(f"{source} does not say where ours was: give the design with --study, or add ours_is")
    questions = () if study is None else study.plan.questions
    by_question = {question.name: {**scale_words(question.labels, question.low), **labels} for question in questions}
    words = [by_question.get(row["question"], labels) for row in rows]
    columns = {
        name: AnswerColumn([row.get(name, "") for row in rows], semicolons=semicolons)
        for name in ("score", "expected", "seconds")
    }
    scores, checks = (_scores(rows, name, columns[name], words, source) for name in ("score", "expected"))
    for row, score, expected in zip(rows, scores, checks, strict=True):
        where = f"{source}, {row['']}"
        for name in ("participant", "item", "question"):
            if not row[name]:
                raise UserError(f"{where}: {name} is empty; expected a name")
        method = _choice(row, "method", ("ours", "theirs"), where, optional=True)
        # The design says where ours was, but a cell that is filled must be a side.
        unplaced = not math.isnan(expected) or (bool(method) if study is None else not row.get("ours_is"))
        side = _choice(row, "ours_is", ("A", "B"), where, optional=unplaced)
        if study is None:
            about: dict[str, Any] = {name: row.get(name, "") for name in ("comparison", "scene", "style")}
            about |= {"ours_is_a": side == "A", "method": method}
        elif math.isnan(score) and not study.shows(row["item"], row["participant"]):
            continue  # in a table with a column for every set, of which each person sees some
        else:
            about = _designed(row, where, source, study)
            design = {"ours_is": "A" if about["ours_is_a"] else "B", "method": about["method"] or method}
            for name, said in (("ours_is", side), ("method", method)):
                if said not in ("", design[name]):
                    raise UserError(f"{where}: {name} is {said}, and by the design it was {design[name]}")
            about["method"] = design["method"]
        seconds = columns["seconds"].number(row.get("seconds", ""))
        if seconds is None:
            raise UserError(f"{where}: seconds is {row['seconds'][:40]!r}; expected a number")
        named = (row["participant"], row["item"], row["question"])
        session = f"session {row['session']} of {source}" if row.get("session") else source
        yield Answer(*named, score, expected=expected, seconds=seconds, source=session, **about)


def _scores(
    rows: Sequence[_Row], name: str, column: AnswerColumn, words: Sequence[Mapping[str, float]], source: str
) -> list[float]:
    """The scores in a column, of each row by its words; cells that have none are refused with what to type."""
    cells = [row.get(name, "") for row in rows]
    values = [column.score(cell, known) for cell, known in zip(cells, words, strict=True)]
    if strange := [index for index, value in enumerate(values) if value is None]:
        counts = Counter(cells[index][:40] for index in strange)
        found = ", ".join(f"{word!r} ({count})" for word, count in counts.most_common(12))
        more = f" and {len(counts) - 12} others" if len(counts) > 12 else ""
        places = {rows[index][""].partition(",")[0] for index in strange}
        header = f"delete {places.pop()} if it is no participant's, but a header; or " if len(places) == 1 else ""
        raise UserError(
            f"{source}, {rows[strange[0]]['']}: {name} is {cells[strange[0]][:40]!r}; expected a number, a word of the "
            f"scale or an empty cell; without a score are {found}{more}: {header}give the scale's words from its "
            "lowest to its highest answer, --labels WORD WORD ..., or one by one, --label WORD=SCORE --label WORD=NA"
        )
    numbered = (cell for cell, known in zip(cells, words, strict=True) if plain(cell) not in known)
    if beside := [cell for cell in numbered if column.number(cell) is None]:
        log.warning("%s: %d answers are read as the number in them, such as %r", source, len(beside), beside[0])
    return [value for value in values if value is not None]


def _designed(row: _Row, where: str, source: str, study: Study) -> dict[str, Any]:
    """The design's facts about an answer of the form."""
    if row.get("study", "") not in ("", study.id):
        raise UserError(f"{source} holds answers to another study ({row['study']}, not {study.id})")
    person, name, side = row["participant"], row["item"], row.get("side", "")
    participant, shown = study.participant(person), study.shown.get(name)
    if participant is None or shown is None:
        what = f"participant {person!r}" if participant is None else f"item {name!r}"
        raise UserError(f"{where}: the design has no {what}")
    if not study.shows(name, person):
        raise UserError(
            f"{where}: the design did not show {name} to {participant.id}, so that it does not say which was ours"
        )
    questions = [question.name for question in study.plan.questions]
    if row["question"] not in questions:
        raise UserError(f"{where}: {unknown('question', row['question'], questions)}")
    item = study.item(name)
    ours_is_a = name in participant.ours_is_a
    comparison = f"{item.baseline} (ours is {item.method})" if item.method else item.baseline
    return {
        "ours_is_a": ours_is_a,
        "method": ("ours" if (side == "A") == ours_is_a else "theirs") if side else "",
        "check": shown.kind if isinstance(shown, Check) else "",
        "of": item.id,
        "comparison": comparison if len(study.baselines) > 1 else "",
        "scene": item.scene,
        "style": item.style,
    }


def _choice(row: _Row, name: str, choices: tuple[str, str], where: str, *, optional: bool) -> str:
    """A cell that is one of two words, in any case; an optional one may also be empty or anything else."""
    cell = row.get(name, "")
    word = next((choice for choice in choices if choice.lower() == cell.lower()), "")
    if not word and not (optional and (name == "ours_is" or not cell)):
        raise UserError(f"{where}: {name} is {cell[:40]!r}; expected {' or '.join(choices)}")
    return word
