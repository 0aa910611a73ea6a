"""Cells of a table as scores: numbers as spreadsheets write them, words of a scale, and answers that are missing."""

import math
import re
from collections.abc import Collection, Mapping, Sequence

from anystyle.errors import UserError
from anystyle_study.contract import Scale

_MISSING = {"na", "n/a", "n.a.", "<na>", "#n/a", "nan", "null", "#null!", "none", "nil", "missing", "no answer", ""}
_MISSING |= {"-", ".", "?"}
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")  # a thousand and some, or one and some thousandths
_GROUPS = {".": r"(\d*|\d{1,3}(,\d{3})+)", ",": r"(\d*|\d{1,3}(\.\d{3})+)"}
_NUMBER = {
    mark: re.compile(rf"[-+]?(?=[{mark}]?\d){groups}([{mark}]\d*)?(e[-+]?\d+)?", re.IGNORECASE)
    for mark, groups in _GROUPS.items()
}
_WORDS = r"(?P<word>\D*[^\W\d_]\D*)"
_NUMBERED = (
    re.compile(r"[(\[]?(?P<number>[-+]?\d+)[)\]]?[\s:=.-]+" + _WORDS),  # `4 - rather B`, `(4) rather B`
    re.compile(_WORDS + r"[(\[](?P<number>[-+]?\d+)[)\]]"),  # `rather B (4)`
)


class AnswerColumn:
    """How the numbers of a column are written, as its cells show; ``semicolons`` separate those of the whole table."""

    def __init__(self, cells: Sequence[str] = (), *, semicolons: bool = False) -> None:
        marked = [(_mark(cell), cell) for cell in map(_joined, cells)]
        marks = {mark for mark, cell in marked if mark and _NUMBER[mark].fullmatch(cell)}
        self._mark = marks.pop() if len(marks) == 1 else ""  # the decimal mark; empty if they show none, or both
        self._semicolons = semicolons

    def number(self, cell: str) -> float | None:
        """The number in a cell, ``nan`` if it is missing; ``None`` if it has no number, or 1.0 might also be 1000."""
        text = _joined(cell)
        if plain(text) in _MISSING:
            return math.nan
        mark = _mark(text) or self._mark
        if not mark and not ("," in text and not self._semicolons):
            mark = "," if "," in text else "."
        if not (mark and _NUMBER[mark].fullmatch(text)):
            return None
        return float(text.replace("," if mark == "." else ".", "").replace(mark, "."))

    def score(self, cell: str, words: Mapping[str, float]) -> float | None:
        """The score in a cell, a number, one of the words, or a number beside a word; ``None`` if it has none."""
        known = words.get(plain(cell))
        value = self.number(cell) if known is None else known
        for found in filter(None, (pattern.fullmatch(plain(cell)) for pattern in _NUMBERED)):
            if value is None and words.get(plain(found["word"]), float(found["number"])) == float(found["number"]):
                value = float(found["number"])
        return value


def plain(text: str) -> str:
    """A word of a scale, whatever its case, spaces, dashes and quotes."""
    text = re.sub(r"[‐-―−]", "-", text.replace("’", "'"))
    return " ".join(text.casefold().split()).strip("'\"")


def scale_words(labels: Sequence[str], low: float) -> dict[str, float]:
    """The score of each label from low to high; those that stand twice, are empty or are numbers have none."""
    names = [plain(label) for label in labels]
    words = [name for name in names if names.count(name) == 1 and re.search(r"[^\d\s.,+-]", name)]
    return {name: low + step for step, name in enumerate(names) if name in words}


def given_scale(labels: Sequence[Sequence[str]]) -> Scale:
    """The scale that the lists of ``--labels`` have, which is 1 to the number of their words."""
    most = max(map(len, labels), default=0)
    return Scale(1.0, float(most)) if most > 1 else Scale()


def given_words(labels: Sequence[Sequence[str]], pairs: Sequence[str], scales: Collection[Scale]) -> dict[str, float]:
    """The scores of ``--labels``, a scale's words from low to high, and of ``--label``, such as ``Unsure=NA``."""
    found: list[tuple[str, float]] = []
    for group in labels:
        lows = {scale.low for scale in scales if len(scale.levels) == len(group)}
        words = scale_words(group, lows.pop()) if len(lows) == 1 else {}
        if len(words) < len(group):
            sizes = " or ".join(dict.fromkeys(str(len(scale.levels)) for scale in scales))
            raise UserError(
                f"--labels {' '.join(map(repr, group))}: expected the {sizes} different words of the scale, from its "
                "lowest to its highest answer (--scale LOW HIGH sets another), or --label WORD=SCORE for each"
            )
        found += words.items()
    for pair in pairs:
        word, _, text = pair.rpartition("=")
        value = AnswerColumn().number(text)
        if not word or value is None:
            raise UserError(f"--label {pair}: expected WORD=SCORE, such as Unsure=NA")
        found.append((plain(word), value))
    scores: dict[str, float] = {}
    for word, value in found:
        if scores.setdefault(word, value) != value and not math.isnan(value):
            raise UserError(f"--labels gives {word!r} the scores {scores[word]:g} and {value:g}; expected one")
    return scores


def _joined(cell: str) -> str:
    """A number without the spaces and apostrophes between its thousands."""
    return re.sub(r"(?<=\d)[\s'’](?=\d{3}(\D|$))", "", cell.replace("−", "-").strip())


def _mark(text: str) -> str:
    """The decimal mark that a number must have; empty if it may have either."""
    marks = re.findall(r"[.,]", text)
    if not marks or _GROUPED.fullmatch(text):
        return ""
    return marks[-1] if marks.count(marks[-1]) == 1 else ".,".replace(marks[-1], "")
