"""What is wrong with answers, who is excluded by which rule, and what remains for analysis."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from anystyle.study.contract import Responses, Scale
from anystyle.study.protocol import Rules
from anystyle.study.reading import Records

_MIXED_SHARE = 0.1  # of a question's answers outside the scale; above, the scale is another one
_STRAIGHT_LINE = 8  # answers from which equal ones count as straight-lining
_KEPT_SHARE = 0.5  # of the participants; where fewer are left, nothing is concluded


@dataclass(frozen=True)
class Finding:
    """Something that a check found.

    Args:
        kind: ``missing``, ``duplicated``, ``out_of_range``, ``fast``, ``straight_lining`` or
            ``failed_attention_check``.
        participant: Whose answers.
        detail: What exactly, in words.
    """

    kind: str
    participant: str
    detail: str


@dataclass(frozen=True)
class Exclusion:
    """A participant left out."""

    participant: str
    rule: str
    detail: str


@dataclass(frozen=True)
class Checks:
    """All that was found, before anything was averaged.

    Args:
        participants_read: How many answered.
        answers_read: Rows of the files, attention checks included.
        attention_answers: Of these, answers to attention checks.
        answers_used: Rows that the analysis uses.
        findings: By kind and participant.
        exclusions: Participants left out.
        notes: What else a reader must know.
    """

    participants_read: int
    answers_read: int
    attention_answers: int
    answers_used: int
    findings: tuple[Finding, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()
    notes: tuple[str, ...] = ()

    def count(self, kind: str) -> int:
        """How many findings of a kind there are."""
        return sum(finding.kind == kind for finding in self.findings)

    @property
    def doubt(self) -> str:
        """Why nothing can be concluded, whatever the tests say; empty where that is not so."""
        kept = self.participants_read - len(self.exclusions)
        if kept < 2:
            return "one participant is left, and nothing is known about any other person"
        if kept < _KEPT_SHARE * self.participants_read:
            return f"{len(self.exclusions)} of {self.participants_read} participants were excluded"
        return ""


@dataclass
class _Log:
    findings: list[Finding] = field(default_factory=list)
    exclusions: dict[str, Exclusion] = field(default_factory=dict)

    def exclude(self, participant: str, rule: str, detail: str) -> None:
        self.exclusions.setdefault(participant, Exclusion(participant, rule, detail))


def check(
    records: Records, *, scale: Scale, rules: Rules, scales: Mapping[str, Scale] | None = None
) -> tuple[Checks, tuple[Responses, ...]]:
    """Judge the answers, leave out what the rules say, and undo the positions; ``scales`` are questions' own.

    Raises:
        ValueError: The scale is another one, or nothing is left.
    """
    by_question = {question: (scales or {}).get(question, scale) for question in np.unique(records.question).tolist()}
    log = _Log()
    attention = ~np.isnan(records.expected) | (records.check != "")
    main = _once(_in_range(records.select(~attention), by_question, log), log)
    _check_attention(records.select(attention), main, by_question, rules, log)
    _check_straight_lines(main, rules, log)
    _check_missing(main, rules, log)
    _check_speed(main, rules, log)
    remaining = main.select(~np.isnan(main.score) & ~np.isin(main.participant, list(log.exclusions)))
    responses = split(remaining, by_question)
    if not any(answers.count for answers in responses):
        raise ValueError(f"no answers are left of {len(records.score)}: {_reasons(log)}")
    read = len(np.unique(records.participant))
    checks = Checks(
        participants_read=read,
        answers_read=len(records.score),
        attention_answers=int(attention.sum()),
        answers_used=len(remaining.score),
        findings=tuple(log.findings),
        exclusions=tuple(log.exclusions.values()),
        notes=tuple(_notes(remaining, read, len(log.exclusions))),
    )
    return checks, tuple(answers for answers in responses if answers.count)


def _undone(records: Records, scales: Mapping[str, Scale]) -> np.ndarray:
    """Deviations of comparisons from the neutral answer, negative where ours is preferred."""
    neutral = np.array([scales[question].midpoint for question in records.question.tolist()])
    return (records.score - neutral) * np.where(records.ours_is_a, 1.0, -1.0) + 0.0


def split(records: Records, scales: Mapping[str, Scale]) -> tuple[Responses, ...]:
    """One :class:`Responses` a question, in order of appearance; several comparisons are kept apart.

    Ratings of the two methods become their difference, theirs less ours, where a person gave both.
    """
    questions = records.question
    if len(np.unique(records.comparison)) > 1:
        questions = np.char.add(np.char.add(questions, " vs "), records.comparison)
    responses: list[Responses] = []
    for question in dict.fromkeys(questions.tolist()):
        rows = records.select(questions == question)
        scale, ratings = scales[str(rows.question[0])], None
        if rows.method[0]:
            rows, ratings = _paired(rows)
            deviations = ratings[1] - ratings[0]
            scale = Scale(scale.low - scale.high, scale.high - scale.low)
        else:
            deviations = _undone(rows, scales)
        people, person = np.unique(rows.participant, return_inverse=True)
        items, first, item = np.unique(rows.item, return_index=True, return_inverse=True)
        responses.append(
            Responses(
                question=question,
                deviations=deviations,
                participants=person,
                items=item,
                ours_is_a=rows.ours_is_a,
                scale=scale,
                participant_names=tuple(people.tolist()),
                item_names=tuple(items.tolist()),
                item_scenes=tuple(rows.scene[first].tolist()) if all(rows.scene) else (),
                item_styles=tuple(rows.style[first].tolist()) if all(rows.style) else (),
                ratings=None if ratings is None or not len(items) else (ratings[0].mean(), ratings[1].mean()),
            )
        )
    return tuple(responses)


def _paired(records: Records) -> tuple[Records, np.ndarray]:
    """One row for each item that a person rated for both methods, and the ratings of ours and of theirs."""
    cells = np.char.add(np.char.add(records.participant, "\n"), records.item)
    ours, theirs = (np.flatnonzero(records.method == method) for method in ("ours", "theirs"))
    _, first, second = np.intersect1d(cells[ours], cells[theirs], return_indices=True)
    rows = records.select(ours[first])
    return rows, np.stack([rows.score, records.score[theirs[second]]])


def _check_attention(records: Records, main: Records, scales: Mapping[str, Scale], rules: Rules, log: _Log) -> None:
    """A given answer, a preference for what is intact, or the side that was preferred the first time."""
    undone = np.sign(_undone(records, scales))
    keys = zip(main.participant.tolist(), main.item.tolist(), main.question.tolist(), strict=True)
    first = dict(zip(keys, np.sign(_undone(main, scales)).tolist(), strict=True))
    again = zip(records.participant.tolist(), records.of.tolist(), records.question.tolist(), strict=True)
    opposite = np.array([first.get(key, 0.0) for key in again]) * undone < 0
    compared = records.method == ""
    failed = np.select(
        [records.check == "degraded", records.check == "repeat"],
        [compared & ~(undone < 0), compared & opposite],
        records.score != records.expected,
    ).astype(bool)
    for person in dict.fromkeys(records.participant[failed].tolist()):
        by_person = records.participant == person
        names = dict.fromkeys(records.item[by_person & failed].tolist())
        detail = f"{len(names)} of {len(set(records.item[by_person].tolist()))} failed: {', '.join(names)}"
        log.findings.append(Finding("failed_attention_check", person, detail))
        if rules.failed_checks is not None and len(names) > rules.failed_checks:
            log.exclude(person, f"more than {rules.failed_checks} attention checks failed", detail)


def _in_range(records: Records, scales: Mapping[str, Scale], log: _Log) -> Records:
    outside = np.zeros(len(records.score), dtype=bool)
    for question in dict.fromkeys(records.question.tolist()):
        rows, scale = np.flatnonzero(records.question == question), scales[question]
        scores = records.score[rows]
        strange = (scores < scale.low) | (scores > scale.high)
        if strange.any() and strange.sum() > _MIXED_SHARE * np.count_nonzero(~np.isnan(scores)):
            raise ValueError(
                f"question {question!r} has answers from {np.nanmin(scores):g} to {np.nanmax(scores):g} where the "
                f"scale is {scale.low:g} to {scale.high:g}; do not mix scales, or give the right one with --scale"
            )
        outside[rows] = strange
    for row in np.flatnonzero(outside):
        detail = f"{records.item[row]}, {records.question[row]}: {records.score[row]:g}, left out"
        log.findings.append(Finding("out_of_range", str(records.participant[row]), detail))
    return records.select(~outside)


def _once(records: Records, log: _Log) -> Records:
    """Keep the first of several answers to the same question of the same set."""
    if not len(records.score):
        return records
    columns = (records.participant, records.item, records.question, records.comparison, records.method)
    cell = np.zeros(len(records.score), dtype=np.int64)
    for column in columns:
        names, code = np.unique(column, return_inverse=True)
        cell = cell * len(names) + code
    _, first, count = np.unique(cell, return_index=True, return_counts=True)
    for row in np.sort(first[count > 1]):
        scores = ", ".join(f"{score:g}" for score in records.score[cell == cell[row]])
        detail = f"{records.item[row]}, {records.question[row]}: {scores}; the first is used"
        log.findings.append(Finding("duplicated", str(records.participant[row]), detail))
    return records.select(np.sort(first))


def _check_straight_lines(records: Records, rules: Rules, log: _Log) -> None:
    answered = records.select(~np.isnan(records.score))
    people, person = np.unique(answered.participant, return_inverse=True)
    counts = np.bincount(person, minlength=len(people))
    low, high = np.full(len(people), np.inf), np.full(len(people), -np.inf)
    np.minimum.at(low, person, answered.score)
    np.maximum.at(high, person, answered.score)
    for index in np.flatnonzero((low == high) & (counts >= _STRAIGHT_LINE)):
        detail = f"all {counts[index]} answers are {low[index]:g}, whichever side ours was on"
        log.findings.append(Finding("straight_lining", str(people[index]), detail))
        if rules.straight_lining:
            log.exclude(str(people[index]), "one answer throughout", detail)


def _check_missing(records: Records, rules: Rules, log: _Log) -> None:
    """Compare with what each person was assigned; without a design, with the sets that they have a row for."""
    asked = len(np.unique(np.char.add(np.char.add(records.question, "\n"), records.method)))
    for person in dict.fromkeys(records.participant.tolist()):
        rows = records.participant == person
        expected = asked * records.assigned.get(person, len(set(records.item[rows].tolist())))
        missing = expected - int(np.count_nonzero(~np.isnan(records.score[rows])))
        if missing <= 0:
            continue
        detail = f"{missing} of {expected} answers"
        log.findings.append(Finding("missing", person, detail))
        if missing > rules.missing_share * expected:
            log.exclude(person, f"more than {rules.missing_share:.0%} of the assigned answers missing", detail)


def _check_speed(records: Records, rules: Rules, log: _Log) -> None:
    """A set takes as long as the slowest of its answers."""
    timed = records.select(~np.isnan(records.seconds))
    if not rules.min_seconds or not len(timed.score):
        return
    cells, cell = np.unique(np.char.add(np.char.add(timed.participant, "\n"), timed.item), return_inverse=True)
    seconds = np.zeros(len(cells))
    np.maximum.at(seconds, cell, timed.seconds)
    people = np.array([name.partition("\n")[0] for name in cells.tolist()])
    for person in np.unique(people[seconds < rules.min_seconds]).tolist():
        fast, total = int(np.sum((seconds < rules.min_seconds)[people == person])), int(np.sum(people == person))
        detail = f"{fast} of {total} sets in less than {rules.min_seconds:g} s"
        log.findings.append(Finding("fast", person, detail))
        if fast > rules.fast_share * total:
            log.exclude(person, f"more than {rules.fast_share:.0%} of the sets answered too fast", detail)


def _notes(records: Records, read: int, excluded: int) -> list[str]:
    notes: list[str] = []
    fraction = float(records.ours_is_a[records.method == ""].mean()) if "" in records.method else 0.5
    if fraction in (0.0, 1.0):
        notes.append(
            f"Ours was always shown as {'A' if fraction else 'B'}: a preference for a side would look like one."
        )
    elif abs(fraction - 0.5) > 0.05:
        notes.append(f"Ours was shown as A in {fraction:.0%} of the answers: positions are not balanced.")
    people, items = len(np.unique(records.participant)), len(np.unique(records.item))
    if excluded:
        notes.append(f"{excluded} of {read} participants ({excluded / read:.0%}) were excluded.")
    if people == 1:
        notes.append("One participant answered: nothing is known about any other person.")
    if items == 1:
        notes.append("One item was judged: nothing is known about any other scene or style.")
    if not records.assigned:
        notes.append("Without the design only empty scores count as missing: who stopped early is not seen.")
    if not (all(records.scene) and all(records.style)):
        notes.append("The items' scenes and styles are not known: claims are of these scenes and styles.")
    if records.unused:
        notes.append(f"Columns not used: {', '.join(records.unused)}.")
    return notes


def _reasons(log: _Log) -> str:
    rules: Sequence[str] = [exclusion.rule for exclusion in log.exclusions.values()]
    reasons = [f"{rules.count(rule)} participant(s) with {rule}" for rule in dict.fromkeys(rules)]
    return "; ".join(reasons) or "every score is missing or outside the scale"
