"""Who answered what: names in several spellings, and people of one name in several files or sessions."""

import logging
import math
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Sequence

from anystyle.errors import UserError
from anystyle.paths import natural
from anystyle_study.answers import Answer

log = logging.getLogger(__name__)


def check_names(answers: Sequence[Answer]) -> None:
    """Refuse people, sets and questions whose names differ in spelling alone: each would count as several."""
    for what, field in (("people", "participant"), ("sets", "item"), ("questions", "question")):
        spelt: dict[str, set[str]] = {}
        for name in {getattr(answer, field) for answer in answers}:
            text = re.sub(r"[\s\u200b-\u200f\u2060\ufeff]", "", unicodedata.normalize("NFKC", name).casefold())
            text = re.sub(r"(?<!\d)[-_.]|[-_.](?!\d)", "", text)  # P-01 is P01, and P01-2 is not P012
            text = re.sub(r"^(\d+)\.0+$", r"\1", text)  # a number of a column with gaps
            spelt.setdefault(re.sub(r"(?<!\d)0+(?=\d)", "", text), set()).add(name)
        if found := sorted(sorted(names) for names in spelt.values() if len(names) > 1):
            more = f" (and {len(found) - 1} more such names)" if len(found) > 1 else ""
            raise UserError(
                f"{what} are named {' and '.join(map(repr, found[0]))}{more}, which differ in case, blanks, dashes, "
                f"dots or zeros alone; give each {field} one name"
            )


def check_sources(answers: Sequence[Answer]) -> None:
    """Refuse people of one name whose answers differ between files or sessions; log that others count as one."""
    given: dict[tuple[str, ...], dict[str, tuple[float, bool]]] = {}  # of each cell the answers by file or session
    places: dict[str, set[str]] = {}
    for answer in answers:
        if not math.isnan(answer.score):
            given.setdefault(answer.cell, {}).setdefault(answer.source, answer.given)
            places.setdefault(answer.participant, set()).add(answer.source)
    common = {cell: answers for cell, answers in given.items() if len(answers) > 1}
    differing = [cell for cell, answers in common.items() if len(set(answers.values())) > 1]
    if differing:
        where = {source for cell in differing for source in common[cell]}
        raise UserError(
            f"{some({cell[0] for cell in differing})} answered {len(differing)} of the {len(common)} questions that "
            f"are in {some(where, ' and ')} differently: add --sessions if they are different people, or leave one of "
            "their answers out"
        )
    _check_twice(answers)
    if several := {name for name, sources in places.items() if len(sources) > 1}:
        where = {source for name in several for source in places[name]}
        told = "%s are in %s, and count as the same people; add --sessions if they are different ones"
        log.warning(told, some(several), some(where, " and "))


def some(names: Collection[str], last: str = ", ") -> str:
    """Three names, ``last`` before the last one, and how many others there are."""
    first, others = sorted(names, key=natural)[:3], len(names) - 3
    if others > 0:
        return f"{', '.join(first)} and {others} others"
    *most, end = first
    return f"{', '.join(most)}{last}{end}" if most else end


def _check_twice(answers: Sequence[Answer]) -> None:
    """Refuse a table in which most people gave two answers to a question: those of several sessions, maybe."""
    given = {(answer.cell, answer.given) for answer in answers if not math.isnan(answer.score)}
    counts = Counter(cell for cell, _ in given)
    twice = {person for (person, *_), count in counts.items() if count > 1}
    if 1 < len(twice) > len({person for person, *_ in counts}) / 2:
        raise UserError(
            f"{some(twice)} gave two different answers to one question: if they are people of several sessions, call "
            "the column that tells these apart session and add --sessions; otherwise leave one of their answers out"
        )
