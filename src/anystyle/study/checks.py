"""What is wrong with answers, who is excluded by which rule, and what remains for analysis."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from anystyle.study.contract import Responses, Scale
from anystyle.study.reading import Records

_MIXED_SHARE = 0.1  # of a question's answers outside the scale; above, the scale is another one


@dataclass(frozen=True)
class Rules:
    """Who and what is left out.

    Args:
        failed_checks: Attention checks a participant may fail before all of their answers are left out.
        straight_lining: Whether to leave out who gave one answer throughout; they are listed either way.
        missing_share: Of their answers, above which a participant is left out.
        straight_line_length: Answers from which equal ones count as straight-lining.
    """

    failed_checks: int = 0
    straight_lining: bool = False
    missing_share: float = 0.5
    straight_line_length: int = 8


@dataclass(frozen=True)
class Finding:
    """Something that a check found.

    Args:
        kind: ``missing``, ``duplicated``, ``out_of_range``, ``straight_lining`` or ``failed_attention_check``.
        participant: Whose answers.
        detail: What exactly, in words.
    """

    kind: str
    participant: str
    detail: str


@dataclass(frozen=True)
class Exclusion:
    """A participant left out.

    Args:
        participant: Who.
        rule: By which rule.
        detail: Why it applies.
    """

    participant: str
    rule: str
    detail: str


@dataclass(frozen=True)
class Checks:
    """All that was found, before anything was averaged.

    Args:
        answers_read: Rows of the files, attention checks included.
        attention_answers: Of these, answers to attention checks.
        answers_used: Rows that the analysis uses.
        findings: By kind and participant.
        exclusions: Participants left out.
        notes: What else a reader must know.
    """

    answers_read: int
    attention_answers: int
    answers_used: int
    findings: tuple[Finding, ...] = ()
    exclusions: tuple[Exclusion, ...] = ()
    notes: tuple[str, ...] = ()

    def count(self, kind: str) -> int:
        """How many findings of a kind there are."""
        return sum(finding.kind == kind for finding in self.findings)


@dataclass
class _Log:
    findings: list[Finding] = field(default_factory=list)
    exclusions: dict[str, Exclusion] = field(default_factory=dict)

    def exclude(self, participant: str, rule: str, detail: str) -> None:
        self.exclusions.setdefault(participant, Exclusion(participant, rule, detail))


def check(records: Records, *, scale: Scale, rules: Rules) -> tuple[Checks, tuple[Responses, ...]]:
    """Judge the answers, leave out what the rules say, and undo the positions.

    Raises:
        ValueError: The scale is another one, or nothing is left.
    """
    log = _Log()
    attention = ~np.isnan(records.expected)
    _check_attention(records.select(attention), rules, log)
    main = records.select(~attention)
    main = _in_range(main, scale, log)
    main = _once(main, log)
    _check_straight_lines(main, rules, log)
    _check_missing(main, rules, log)
    remaining = main.select(~np.isnan(main.score) & ~np.isin(main.participant, list(log.exclusions)))
    if not len(remaining.score):
        raise ValueError(f"no answers are left of {len(records.score)}: {_reasons(log)}")
    checks = Checks(
        answers_read=len(records.score),
        attention_answers=int(attention.sum()),
        answers_used=len(remaining.score),
        findings=tuple(log.findings),
        exclusions=tuple(log.exclusions.values()),
        notes=tuple(_notes(remaining)),
    )
    return checks, split(remaining, scale)


def split(records: Records, scale: Scale) -> tuple[Responses, ...]:
    """One :class:`Responses` a question, in order of appearance; several comparisons are kept apart."""
    multiple = len(np.unique(records.comparison)) > 1
    questions = records.question
    if multiple:
        questions = np.char.add(np.char.add(questions, " vs "), records.comparison)
    people, person = np.unique(records.participant, return_inverse=True)
    items, item = np.unique(records.item, return_inverse=True)
    responses: list[Responses] = []
    for question in dict.fromkeys(questions.tolist()):
        rows = questions == question
        flipped = np.where(records.ours_is_a[rows], 1.0, -1.0)
        responses.append(
            Responses(
                question=question,
                deviations=(records.score[rows] - scale.midpoint) * flipped + 0.0,
                participants=person[rows],
                items=item[rows],
                ours_is_a=records.ours_is_a[rows],
                scale=scale,
                participant_names=tuple(people.tolist()),
                item_names=tuple(items.tolist()),
            )
        )
    return tuple(responses)


def _check_attention(records: Records, rules: Rules, log: _Log) -> None:
    failed = records.score != records.expected
    for person in dict.fromkeys(records.participant[failed].tolist()):
        by_person = records.participant == person
        checks = dict.fromkeys(records.item[by_person & failed].tolist())
        total = len(set(records.item[by_person].tolist()))
        detail = f"{len(checks)} of {total} failed: {', '.join(checks)}"
        log.findings.append(Finding("failed_attention_check", person, detail))
        if len(checks) > rules.failed_checks:
            log.exclude(person, f"more than {rules.failed_checks} attention checks failed", detail)


def _in_range(records: Records, scale: Scale, log: _Log) -> Records:
    outside = (records.score < scale.low) | (records.score > scale.high) | np.isinf(records.score)
    for question in dict.fromkeys(records.question[outside].tolist()):
        of_question = records.question == question
        scores = records.score[of_question & ~np.isnan(records.score)]
        if np.mean((scores < scale.low) | (scores > scale.high)) > _MIXED_SHARE:
            raise ValueError(
                f"question {question!r} has answers from {scores.min():g} to {scores.max():g} where the scale is "
                f"{scale.low:g} to {scale.high:g}; do not mix scales, or give the right one with --scale"
            )
    for row in np.flatnonzero(outside):
        detail = f"{records.item[row]}, {records.question[row]}: {records.score[row]:g}, left out"
        log.findings.append(Finding("out_of_range", str(records.participant[row]), detail))
    return records.select(~outside)


def _codes(records: Records) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    columns = (records.participant, records.item, np.char.add(np.char.add(records.question, "\n"), records.comparison))
    person, item, question = (np.unique(column, return_inverse=True)[1] for column in columns)
    return person, item, question


def _once(records: Records, log: _Log) -> Records:
    """Keep the first of several answers to the same question of the same set."""
    if not len(records.score):
        return records
    person, item, question = _codes(records)
    cell = (person * (item.max() + 1) + item) * (question.max() + 1) + question
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
    for index in np.flatnonzero((low == high) & (counts >= rules.straight_line_length)):
        detail = f"all {counts[index]} answers are {low[index]:g}, whichever side ours was on"
        log.findings.append(Finding("straight_lining", str(people[index]), detail))
        if rules.straight_lining:
            log.exclude(str(people[index]), "one answer throughout", detail)


def _check_missing(records: Records, rules: Rules, log: _Log) -> None:
    """Compare with the fullest participant: studies may show each one only some of the sets."""
    people, person = np.unique(records.participant, return_inverse=True)
    answered = np.bincount(person, weights=~np.isnan(records.score), minlength=len(people)).astype(int)
    expected = int(answered.max(initial=0))
    for index in np.flatnonzero(answered < expected):
        detail = f"{expected - answered[index]} of {expected} answers"
        log.findings.append(Finding("missing", str(people[index]), detail))
        if expected - answered[index] > rules.missing_share * expected:
            log.exclude(str(people[index]), f"more than {rules.missing_share:.0%} of the answers missing", detail)


def _notes(records: Records) -> list[str]:
    notes: list[str] = []
    fraction = float(records.ours_is_a.mean())
    if fraction in (0.0, 1.0):
        notes.append(
            f"Ours was always shown as {'A' if fraction else 'B'}: a preference for a side would look like one."
        )
    elif abs(fraction - 0.5) > 0.05:
        notes.append(f"Ours was shown as A in {fraction:.0%} of the answers: positions are not balanced.")
    people, items = len(np.unique(records.participant)), len(np.unique(records.item))
    if people == 1:
        notes.append("One participant answered: nothing is known about any other person.")
    if items == 1:
        notes.append("One item was judged: nothing is known about any other scene or style.")
    if records.unused:
        notes.append(f"Columns not used: {', '.join(records.unused)}.")
    return notes


def _reasons(log: _Log) -> str:
    rules: Sequence[str] = [exclusion.rule for exclusion in log.exclusions.values()]
    reasons = [f"{rules.count(rule)} participant(s) with {rule}" for rule in dict.fromkeys(rules)]
    return "; ".join(reasons) or "every score is missing or outside the scale"
