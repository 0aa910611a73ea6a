"""Problems found in the answers, participants excluded by which rule, and the answers that remain for analysis."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import Any

import numpy as np

from anystyle.errors import UserError
from anystyle_study.answers import Answer, Records
from anystyle_study.contract import Responses, Scale
from anystyle_study.people import some
from anystyle_study.protocol import Rules

KINDS = ("failed_attention_check", "fast", "duplicated", "out_of_range", "straight_lining", "missing")
_MAX_OUTSIDE = 0.1  # fraction of a question's answers outside the scale; above it, the scale must be another one
_MIN_STRAIGHT = 8  # answers to a question, all equal, that count as straight-lining
_MIN_KEPT = 0.5  # fraction of the participants; with fewer left, there is no conclusion


@dataclass(frozen=True)
class Finding:
    """A problem, of a kind in :data:`KINDS`."""

    kind: str
    participant: str  # whose answers
    detail: str  # details for the reader
    rule: str = ""  # the rule by which it excludes the participant; empty if it does not


@dataclass
class Checks:
    """The result of all checks."""

    participants_read: int  # number of participants
    answers_read: int  # answers that were given, attention checks included
    attention_answers: int  # of these, answers to attention checks
    answers_used: int = 0  # rows that the analysis uses
    findings: list[Finding] = field(default_factory=list)  # problems, by kind and participant
    exclusions: list[Finding] = field(default_factory=list)  # the first reason to leave out each excluded participant
    notes: list[str] = field(default_factory=list)  # caveats for the reader
    # number of answers that are missing, by participant and question; only of those who lack any
    missing: dict[str, dict[str, int]] = field(default_factory=dict)

    def of_kind(self, kind: str) -> list[Finding]:
        """Findings of a kind."""
        return [finding for finding in self.findings if finding.kind == kind]

    def add(self, kind: str, participant: str, detail: str, rule: str = "") -> None:
        """Record a problem; with a ``rule``, the participant is excluded by it unless an earlier one did so."""
        self.findings.append(Finding(kind, participant, detail, rule))
        if rule and participant not in {exclusion.participant for exclusion in self.exclusions}:
            self.exclusions.append(self.findings[-1])

    @property
    def doubt(self) -> str:
        """Why there is no conclusion, whatever the tests find; empty if there may be one."""
        kept = self.participants_read - len(self.exclusions)
        if kept < 2:
            return "one participant is left, and nothing is known about any other person"
        excluded = f"{len(self.exclusions)} of {self.participants_read} participants were excluded"
        return excluded if kept < _MIN_KEPT * self.participants_read else ""


def check(
    records: Records, *, scale: Scale, rules: Rules, scales: Mapping[str, Scale] | None = None
) -> tuple[Checks, tuple[Responses, ...]]:
    """Check the answers, exclude participants by the rules, and undo the positions; ``scales`` are by question."""
    people = {answer.participant for answer in records.answers if not math.isnan(answer.score)}
    silent = sorted({answer.participant for answer in records.answers} - people)
    answers = [answer for answer in (*records.answers, *records.unanswered) if answer.participant in people]
    by_question = {answer.question: (scales or {}).get(answer.question, scale) for answer in answers}
    attention = [answer for answer in answers if answer.is_check]
    given = [answer.is_check for answer in records.answers if not math.isnan(answer.score)]
    checks = Checks(len(people), len(given), sum(given))
    main = [answer for answer in answers if not answer.is_check]
    items = {who: {(row.item, row.comparison) for row in of} for who, of in _grouped(main, "participant").items()}
    facts = {(row.item, name, value) for row in main for name in ("scene", "style") if (value := getattr(row, name))}
    if twice := [item for (item, _), number in Counter(fact[:2] for fact in facts).items() if number > 1]:
        raise UserError(f"sets of several scenes or styles: {some(sorted(set(twice)))}; give each a name of its own")
    known = {(item, name): value for item, name, value in facts}  # a file may say what another leaves out
    about = {item: {name: known.get((item, name), "") for name in ("scene", "style")} for item, _, _ in facts}
    main = [replace(row, **about.get(row.item, {})) for row in main]
    main = _deduplicated(_in_range(main, by_question, checks), checks)
    _check_attention(attention, main, by_question, rules, checks)
    asked = Counter(question for question, _ in {(answer.question, answer.method) for answer in main})
    asked = {name: asked[name] for name in dict.fromkeys(answer.question for answer in main)}
    for person, answers in _grouped(main, "participant").items():
        given = [answer for answer in answers if not math.isnan(answer.score)]
        _check_straight_lining(person, given, rules, checks)
        # Without a design, only sets with a row count as assigned.
        sets = records.assigned.get(person, len(items[person]))
        _check_missing(person, given, {question: sets * count for question, count in asked.items()}, rules, checks)
        _check_speed(person, answers, rules, checks)
    excluded = {exclusion.participant for exclusion in checks.exclusions}
    remaining = [answer for answer in main if not math.isnan(answer.score) and answer.participant not in excluded]
    responses = tuple(part for part in split(remaining, by_question) if part.count)
    if not responses:
        names = [exclusion.rule for exclusion in checks.exclusions]
        reasons = [f"{names.count(rule)} participant(s) with {rule}" for rule in dict.fromkeys(names)]
        unpaired = "nobody rated both methods, ours and theirs, of a set"
        why = "; ".join(reasons) or (unpaired if remaining else "every score is missing or outside the scale")
        raise UserError(f"no answers are left of {checks.answers_read}: {why}")
    checks.answers_used = len(remaining)
    if silent:
        checks.notes.append(f"{len(silent)} people gave no answer at all and are not counted: {some(silent)}.")
    checks.notes += _notes(records, remaining, checks)
    return checks, responses


def split(answers: Sequence[Answer], scales: Mapping[str, Scale]) -> list[Responses]:
    """One :class:`Responses` a question, in order of appearance; several comparisons are kept apart.

    Ratings of the two methods become their difference, theirs minus ours, where a person gave both.
    """
    several = len({answer.comparison for answer in answers}) > 1
    responses = []
    for (question, comparison), rows in _grouped(answers, "question", "comparison").items():
        scale, ratings = scales[question], None
        if rows[0].method:
            theirs = {(row.participant, row.item): row.score for row in rows if row.method == "theirs"}
            rows = [row for row in rows if row.method == "ours" and (row.participant, row.item) in theirs]
            pairs = [(row.score, theirs[row.participant, row.item]) for row in rows]
            deviations = [other - own for own, other in pairs]
            ratings = (fmean(own for own, _ in pairs), fmean(other for _, other in pairs)) if pairs else None
            scale = Scale(scale.low - scale.high, scale.high - scale.low)
        else:
            deviations = [_undone(row, scales) for row in rows]
        people, person = np.unique([row.participant for row in rows], return_inverse=True)
        items, first, item = np.unique([row.item for row in rows], return_index=True, return_inverse=True)
        scenes, styles = (tuple(getattr(rows[index], name) for index in first) for name in ("scene", "style"))
        responses.append(
            Responses(
                question=f"{question} vs {comparison}" if several else question,
                deviations=np.array(deviations, dtype=float).round(12),  # scores in tenths are equal where they are
                participants=person,
                items=item,
                ours_is_a=np.array([row.ours_is_a for row in rows], dtype=bool),
                scale=scale,
                participant_names=tuple(people.tolist()),
                item_names=tuple(items.tolist()),
                item_scenes=scenes if all(scenes) else (),
                item_styles=styles if all(styles) else (),
                ratings=ratings,
            )
        )
    return responses


def _grouped(answers: Iterable[Answer], *names: str) -> dict[Any, list[Answer]]:
    """Answers by one or more of their fields, in order of appearance."""
    groups: dict[Any, list[Answer]] = defaultdict(list)
    for answer in answers:
        key = [getattr(answer, name) for name in names]
        groups[tuple(key) if names[1:] else key[0]].append(answer)
    return groups


def _undone(answer: Answer, scales: Mapping[str, Scale]) -> float:
    """Deviation of a comparison from the neutral answer; negative prefers ours."""
    return (answer.score - scales[answer.question].midpoint) * (1 if answer.ours_is_a else -1) + 0.0


def _check_attention(
    answers: Sequence[Answer], main: Sequence[Answer], scales: Mapping[str, Scale], rules: Rules, checks: Checks
) -> None:
    """Checks have a given answer, ask to prefer the intact side, or must not reverse the first preference.

    In ratings the degraded side must not be rated above the intact one, which is ``ours``.
    """
    first = {(answer.participant, answer.item, answer.question): answer for answer in main}
    of_sides = {answer.cell: answer.score for answer in answers if answer.check == "degraded"}

    def failed(answer: Answer) -> bool:
        if not answer.check:
            return answer.score != answer.expected
        again = np.sign(_undone(answer, scales))
        if answer.method:
            theirs = of_sides.get((*answer.cell[:-1], "theirs"), -math.inf)
            return answer.check == "degraded" and not answer.score >= theirs
        if answer.check == "degraded":
            return not again < 0
        before = first.get((answer.participant, answer.of, answer.question))
        return before is not None and bool(np.sign(_undone(before, scales)) * again < 0)

    for person, given in _grouped(answers, "participant").items():
        unanswered = {answer.item for answer in given if math.isnan(answer.score)}
        names = list(dict.fromkeys(answer.item for answer in given if failed(answer)))
        if names:
            listed = ", ".join(f"{name} (no answer)" if name in unanswered else name for name in names)
            detail = f"{len(names)} of {len({answer.item for answer in given})} failed: {listed}"
            strict = rules.failed_checks is not None and len(names) > rules.failed_checks
            rule = f"more than {rules.failed_checks} attention checks failed" if strict else ""
            checks.add("failed_attention_check", person, detail, rule)


def _check_straight_lining(person: str, given: Sequence[Answer], rules: Rules, checks: Checks) -> None:
    """One answer throughout a question is listed; it excludes where every question with enough answers has one."""
    long = {name: same for name, same in _grouped(given, "question").items() if len(same) >= _MIN_STRAIGHT}
    straight = {name: same for name, same in long.items() if len({answer.score for answer in same}) == 1}
    rule = "one answer throughout every question" if rules.straight_lining and len(straight) == len(long) else ""
    for name, same in straight.items():
        detail = f"{name}: all {len(same)} answers are {same[0].score:g}, whichever side ours was on"
        checks.add("straight_lining", person, detail, rule)


def _check_missing(
    person: str, given: Sequence[Answer], expected: Mapping[str, int], rules: Rules, checks: Checks
) -> None:
    """Answers that are missing of the number expected to each question."""
    answered = Counter(answer.question for answer in given)
    lacking = {question: count - answered[question] for question, count in expected.items()}
    lacking = {question: count for question, count in lacking.items() if count > 0}
    if lacking:
        checks.missing[person] = lacking
        missing, total = sum(lacking.values()), sum(expected.values())
        strict = missing > rules.missing_share * total
        rule = f"more than {rules.missing_share:.0%} of the assigned answers missing" if strict else ""
        listed = ", ".join(f"{question} {count}" for question, count in lacking.items())
        checks.add("missing", person, f"{missing} of {total} answers ({listed})", rule)


def _check_speed(person: str, answers: Sequence[Answer], rules: Rules, checks: Checks) -> None:
    """Sets that were answered too fast; a set takes as long as the slowest of its answers."""
    timed = _grouped((answer for answer in answers if not math.isnan(answer.seconds)), "item").values()
    if fast := sum(max(answer.seconds for answer in same) < rules.min_seconds for same in timed):
        strict = fast > rules.fast_share * len(timed)
        rule = f"more than {rules.fast_share:.0%} of the sets answered too fast" if strict else ""
        checks.add("fast", person, f"{fast} of {len(timed)} sets in less than {rules.min_seconds:g} s", rule)


def _in_range(answers: Sequence[Answer], scales: Mapping[str, Scale], checks: Checks) -> list[Answer]:
    def outside(answer: Answer) -> bool:
        return answer.score < scales[answer.question].low or answer.score > scales[answer.question].high

    for question, given in _grouped(answers, "question").items():
        if len({bool(answer.method) for answer in given}) > 1:
            raise UserError(f"question {question!r} has both comparisons and ratings; give them two names")
        scale, scores = scales[question], [answer.score for answer in given if not math.isnan(answer.score)]
        strange = [answer.score for answer in filter(outside, given)]
        # Buttons that are counted from 0 fit a scale of the same length: few are outside, and all others are shifted.
        beyond = {*strange} in ({scale.low - 1}, {scale.high + 1})
        shifted = beyond and max(scores) - min(scores) <= scale.high - scale.low
        if shifted or len(strange) > _MAX_OUTSIDE * len(scores):
            farthest = max(strange, key=lambda score: abs(score - scale.midpoint))
            raise UserError(
                f"question {question!r} has answers from {min(scores):g} to {max(scores):g} where the "
                f"scale is {scale.low:g} to {scale.high:g}; do not mix scales, give the right one with --scale, or say "
                f"which number stands for a missing answer, as with --label={farthest:g}=NA"
            )
        sides = {answer.ours_is_a for answer in given if not answer.method}
        halves = {score > scale.midpoint for score in {*scores} - {*strange, scale.midpoint}}
        if len(sides) == 2 and len(halves) == 1 and len(scores) >= _MIN_STRAIGHT:
            checks.notes.append(
                f"All answers to {question} are on one half of the scale of {scale.low:g} to {scale.high:g}, whichever "
                "side ours was on: if they are of another scale, give it with --scale."
            )
    for answer in filter(outside, answers):
        checks.add("out_of_range", answer.participant, f"{answer.item}, {answer.question}: {answer.score:g}, left out")
    return [answer for answer in answers if not outside(answer)]


def _deduplicated(answers: Sequence[Answer], checks: Checks) -> list[Answer]:
    """Keep the first of several answers to the same question of the same set; a missing one is none."""
    kept, people, sources, differ = [], Counter[str](), set[str](), 0
    for same in _grouped(answers, "cell").values():
        given = [answer for answer in same if not math.isnan(answer.score)]
        kept.append((given or same)[0])
        if len(given) > 1:
            scores = ", ".join(f"{answer.score:g}" for answer in given)
            detail = f"{same[0].item}, {same[0].question}: {scores}; the first is used"
            checks.add("duplicated", same[0].participant, detail)
            people[same[0].participant] += 1
            sources |= {answer.source for answer in given}
            differ += len({answer.given for answer in given}) > 1
    if people:
        counts = some([f"{person}: {count}" for person, count in people.items()])
        where = f"; in {some(sources, ' and ')}" if len(sources) > 1 else ""
        alike = f"{differ} differ" if differ else "all are alike"
        checks.notes.append(
            f"{people.total()} answers were given more than once ({counts}{where}). The first counts; {alike}."
        )
    return kept


def _notes(records: Records, answers: Sequence[Answer], checks: Checks) -> Iterable[str]:
    sides = [answer.ours_is_a for answer in answers if not answer.method]
    fraction = sum(sides) / len(sides) if sides else 0.5
    if fraction in (0.0, 1.0):
        yield f"Ours was always shown as {'A' if fraction else 'B'}: a preference for a side would look like one."
    elif abs(fraction - 0.5) > 0.05:
        yield f"Ours was shown as A in {fraction:.0%} of the answers: positions are not balanced."
    excluded, read = len(checks.exclusions), checks.participants_read
    if excluded:
        yield f"{excluded} of {read} participants ({excluded / read:.0%}) were excluded."
    if len({answer.participant for answer in answers}) == 1:
        yield "One participant answered: nothing is known about any other person."
    if len({answer.item for answer in answers}) == 1:
        yield "One item was judged: nothing is known about any other scene or style."
    if not records.assigned:
        yield "Without the design, only empty scores count as missing: participants who stopped early are not detected."
    if not all(answer.scene and answer.style for answer in answers):
        yield "The items' scenes and styles are not known: claims hold for these scenes and styles."
    if records.unused:
        yield f"Columns not used: {', '.join(records.unused)}."
