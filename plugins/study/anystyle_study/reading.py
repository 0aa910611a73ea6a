"""Answers from CSV or JSON files, one answer per row, as the form stores them or from any other form.

The form's answers do not say where ours was; the design does. A table from elsewhere says it in ``ours_is`` (A or B),
or whose rating it is in ``method`` (ours or theirs).
"""

import logging
import math
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from anystyle.errors import UserError, unknown
from anystyle.paths import natural
from anystyle_study.cells import AnswerColumn, plain, scale_words
from anystyle_study.files import plain_name, read_sheet
from anystyle_study.protocol import Check, Study
from anystyle_study.wide import long_rows

log = logging.getLogger(__name__)

REQUIRED = ("participant", "item", "question", "score")  # the columns that every table has
_OPTIONAL = ("study", "side", "ours_is", "method", "scene", "style", "expected", "comparison", "seconds", "comment")
_OPTIONAL += ("session",)
_BOOKKEEPING = ("time", "device", "revision", "received", "id")
_KNOWN = frozenset(("", *REQUIRED, *_OPTIONAL, *_BOOKKEEPING))
_SUFFIXES = (".csv", ".tsv", ".json")
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
    source: str = ""  # the file, or the session in it, that has the answer

    @property
    def cell(self) -> tuple[str, ...]:
        """What it answers: a person has one answer of each."""
        return self.participant, self.item, self.question, self.comparison, self.method

    @property
    def given(self) -> tuple[float, bool]:
        """The answer: a score means another thing where ours was on the other side."""
        return self.score, self.ours_is_a

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
    tables = {file: _rows(file, wide=wide, columns=columns, study=study) for file in files}
    if sessions:
        for file, (table, _) in tables.items():
            for row in table:
                parts = (row["participant"], file.stem if len(files) > 1 else "", row.get("session", ""))
                row["participant"] = "-".join(filter(None, parts))
    answers = [answer for file, table in tables.items() for answer in _answers(*table, file.name, study, labels)]
    _check_names(answers)
    _check_sources(answers)
    people = {answer.participant for answer in answers}
    assigned = {} if study is None else {person: count for person in people if (count := study.num_items(person))}
    rows = [row for table, _ in tables.values() for row in table]
    return Records(
        answers=tuple(answers),
        assigned=assigned,
        comments=tuple(dict.fromkeys((row["participant"], row["comment"]) for row in rows if row.get("comment"))),
        unused=tuple(dict.fromkeys(name for table, _ in tables.values() for name in table[0] if name not in _KNOWN)),
        sources=tuple(file.name for file in files),
    )


def _check_names(answers: Sequence[Answer]) -> None:
    """Refuse people whose names differ in spelling alone: they would count as more than they are."""
    spelt: dict[str, set[str]] = {}
    for name in {answer.participant for answer in answers}:
        text = re.sub(r"[\s\u200b-\u200f\u2060\ufeff]", "", unicodedata.normalize("NFKC", name).casefold())
        text = re.sub(r"(?<!\d)[-_]|[-_](?!\d)", "", text)  # P-01 is P01, and P01-2 is not P012
        text = re.sub(r"^(\d+)\.0+$", r"\1", text)  # a number of a column with gaps
        spelt.setdefault(re.sub(r"(?<!\d)0+(?=\d)", "", text), set()).add(name)
    if found := sorted(sorted(names) for names in spelt.values() if len(names) > 1):
        more = f", and {len(found) - 1} others so" if len(found) > 1 else ""
        raise UserError(
            f"people are named {' and '.join(map(repr, found[0]))}{more}: names that differ in case, blanks, "
            "dashes or zeros alone; give each person one name"
        )


def _check_sources(answers: Sequence[Answer]) -> None:
    """Refuse people of one name whose answers differ between files or sessions; log that others count as one."""
    given: dict[tuple[str, ...], dict[str, tuple[float, bool]]] = {}  # of each cell the answers by file or session
    places: dict[str, set[str]] = {}
    for answer in answers:
        if not math.isnan(answer.score):
            given.setdefault(answer.cell, {}).setdefault(answer.source, answer.given)
            places.setdefault(answer.participant, set()).add(answer.source)
    common = {cell: answers for cell, answers in given.items() if len(answers) > 1}
    differing = [cell for cell, answers in common.items() if len(set(answers.values())) > 1]
    people = {cell[0] for cell in differing}
    apart = "if they are other people in each, --sessions names them apart"
    if people:
        where = {source for cell in differing for source in common[cell]}
        raise UserError(
            f"{some(people)} answered {len(differing)} of the {len(common)} questions that are in "
            f"{some(where, ' and ')} differently: {apart}; else leave one of their answers out"
        )
    if several := {name for name, sources in places.items() if len(sources) > 1}:
        where = {source for name in several for source in places[name]}
        told = "%s are in %s, and count as the same people; %s"
        log.warning(told, some(several), some(where, " and "), apart)


def some(names: Collection[str], last: str = ", ") -> str:
    """Three names, ``last`` before the last one, and how many others there are."""
    first, others = sorted(names, key=natural)[:3], len(names) - 3
    if others > 0:
        return f"{', '.join(first)} and {others} others"
    *most, end = first
    return f"{', '.join(most)}{last}{end}" if most else end


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    inside = [file for file in sorted(path.iterdir()) if file.is_file()]
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
    names = [plain_name(name) if plain_name(name) in _KNOWN else name for name in sheet.names]
    missing = [name for name in REQUIRED if name not in names]
    if missing and (wide or columns):
        table = long_rows(sheet, path.name, columns, () if study is None else study.shown)
    elif missing:
        raise UserError(
            f"{path.name} lacks the column{'s' * (len(missing) > 1)} {', '.join(missing)}; it has "
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
            told = "%s: %d rows without item, question and score are left out as other trials, such as %s"
            log.warning(told, path.name, len(others), others[0])
        table = list(filter(_is_answer, table))
    if not table:
        raise UserError(f"{path.name} holds a header and no answers; expected one answer per row")
    return table, sheet.semicolons


def _is_answer(row: _Row) -> bool:
    """Whether a row is about a set; an experiment's instructions and pauses are rows, too."""
    return any(row[name] for name in ("item", "question", "score"))


def _answers(
    rows: Sequence[_Row], semicolons: bool, source: str, study: Study | None, labels: Mapping[str, float]
) -> Iterable[Answer]:
    placed = "ours_is" in rows[0] or "method" in rows[0]
    if not placed and study is None:
        raise UserError(f"{source} does not say where ours was: give the design with --study, or add ours_is")
    columns = {
        name: AnswerColumn([row.get(name, "") for row in rows], semicolons=semicolons)
        for name in ("score", "expected", "seconds")
    }
    questions = () if study is None else study.plan.questions
    words = {question.name: {**scale_words(question.labels, question.low), **labels} for question in questions}
    known = [words.get(row["question"], labels) for row in rows]
    values = {
        name: [columns[name].score(row.get(name, ""), of) for row, of in zip(rows, known, strict=True)]
        for name in ("score", "expected")
    }
    for name, found in values.items():
        if None in found:
            raise UserError(_unread(rows, name, found, source))
    cells = [row["score"] for row, of in zip(rows, known, strict=True) if plain(row["score"]) not in of]
    if beside := [cell for cell in cells if columns["score"].number(cell) is None]:
        log.warning("%s: %d answers are read as the number in them, such as %r", source, len(beside), beside[0])
    for row, score, expected in zip(rows, values["score"], values["expected"], strict=True):
        where = f"{source}, {row['']}"
        for name in ("participant", "item", "question"):
            if not row[name]:
                raise UserError(f"{where}: {name} is empty; expected a name")
        assert score is not None and expected is not None
        method = _choice(row, "method", ("ours", "theirs"), where, optional=True)
        if placed or study is None:
            side = _choice(row, "ours_is", ("A", "B"), where, optional=bool(method) or not math.isnan(expected))
            about: dict[str, Any] = {name: row.get(name, "") for name in ("comparison", "scene", "style")}
            about |= {"ours_is_a": side == "A", "method": method}
        elif math.isnan(score) and not study.shows(row["item"], row["participant"]):
            continue  # in a table with a column for every set, of which each person sees some
        else:
            about = _designed(row, where, source, study)
        seconds = columns["seconds"].number(row.get("seconds", ""))
        if seconds is None:
            raise UserError(f"{where}: seconds is {row['seconds'][:40]!r}; expected a number")
        named = (row["participant"], row["item"], row["question"])
        session = f"session {row['session']} of {source}" if row.get("session") else source
        yield Answer(*named, score, expected=expected, seconds=seconds, source=session, **about)


def _unread(rows: Sequence[_Row], name: str, values: Sequence[float | None], source: str) -> str:
    """What is said of cells that have no score: the first one, all that were found, and what to type."""
    strange = [row for row, value in zip(rows, values, strict=True) if value is None]
    counts = Counter(row[name][:40] for row in strange)
    found = ", ".join(f"{word!r} ({count})" for word, count in counts.most_common(12))
    more = f" and {len(counts) - 12} others" if len(counts) > 12 else ""
    return (
        f"{source}, {strange[0]['']}: {name} is {strange[0][name][:40]!r}; expected a number, a word of the scale "
        f"or an empty cell; without a score are {found}{more}: give the scale's words from its lowest to its highest "
        "answer, --labels WORD WORD ..., or one by one, --label WORD=SCORE --label WORD=NA"
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
    if not study.shows(name, person):
        raise UserError(
            f"{where}: the design did not show {name} to {participant.id}, so that it does not say which was ours"
        )
    questions = [question.name for question in study.plan.questions]
    if row["question"] not in questions:
        raise UserError(f"{where}: {unknown('question', row['question'], questions)}")
    item = study.item(name)
    ours_is_a = name in participant.ours_is_a
    of = f" (ours is {item.method})" * bool(item.method)
    return {
        "ours_is_a": ours_is_a,
        "method": ("ours" if (side == "A") == ours_is_a else "theirs") if side else "",
        "check": shown.kind if isinstance(shown, Check) else "",
        "of": item.id,
        "comparison": item.baseline + of if len(study.baselines) > 1 else "",
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
