"""Results in words and numbers, as a paper states them; the same sentences in every format."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from anystyle_study.analysis import Analysis, QuestionAnalysis
from anystyle_study.contract import Population

_CLAIMS = {"two-sided": "two-sided", "less": "one-sided (ours is preferred)", "greater": "one-sided (theirs is)"}
_TITLES = {"cohens_d": "Cohen's d", "rank_biserial": "rank-biserial"}
_MIN_PEOPLE = 10  # fewer participants do not show how much people differ


def title_of(name: str) -> str:
    """Display name of a test or an effect."""
    return _TITLES.get(name, name.replace("_", " "))


def percent(fraction: float) -> str:
    """A fraction as a percentage."""
    return f"{100 * fraction:.0f} %"


def p_text(pvalue: float) -> str:
    """A p-value with its relation sign: ``= 0.013``, ``= 3.5e-40``, ``< 1e-300``."""
    if math.isnan(pvalue):
        return "n/a"
    if pvalue < 1e-300:
        return "< 1e-300"
    return f"= {pvalue:{'.2e' if pvalue < 1e-4 else '.4f' if pvalue < 1e-3 else '.3f'}}"


def bounds(interval: tuple[float, float]) -> str:
    """An interval; a dash if there is none."""
    if any(map(math.isnan, interval)):
        return "—"
    low, high = (f"{end:.2f}" if math.isfinite(end) else "−∞" if end < 0 else "∞" for end in interval)
    return f"[{low}, {high}]"


def generalization(populations: Sequence[Population]) -> str:
    """What a result generalises to: ``new participants and scenes, these styles``."""
    if not populations:
        return "no one else"
    *parts, last = ("sets" if population == "items" else population for population in populations)
    new = "new " + (f"{', '.join(parts)} and {last}" if parts else last)
    shared = [factor for factor in ("scenes", "styles") if factor not in populations]
    if "items" in populations:
        new += " of these scenes and styles"
    elif shared:
        new += f", these {shared[0] if len(shared) == 1 else 'sets'}"
    return new if "participants" in populations else f"{new}, these participants"


def fractions(question: QuestionAnalysis) -> tuple[float, float, float]:
    """Fractions of the answers that prefer ours, neither and theirs."""
    signs = np.sign(question.responses.deviations)
    return float(np.mean(signs < 0)), float(np.mean(signs == 0)), float(np.mean(signs > 0))


def verdict(analysis: Analysis, question: QuestionAnalysis) -> str:
    """The conclusion in one sentence: a preference, equivalence, or neither."""
    primary, equivalence = question.primary, question.equivalence
    if analysis.checks.doubt:
        return f"No conclusion is possible: {analysis.checks.doubt}."
    if primary is None:
        notes = [named.result.note for named in question.tests if named.result.note]
        return f"No conclusion is possible: {notes[0] if notes else 'no test generalises to new participants'}."
    result, level = primary.result, 1 - analysis.settings.confidence
    whom, adjusted = generalization(result.generalizes_to), primary.pvalue_holm
    evidence = f"(p {p_text(adjusted)}, adjusted over the questions)"
    margin = f"the margin of {equivalence.margin:.2g} points" if equivalence else ""
    shown = equivalence is not None and equivalence.shown
    if adjusted <= level and result.estimate != 0:
        by = f", by less than {margin}" if shown else ""
        return f"{'Ours' if result.estimate < 0 else 'Theirs'} is preferred{by}, and this holds for {whom} {evidence}."
    if result.pvalue <= level and result.estimate != 0:
        return f"A preference is indicated for {whom}, but not confirmed over all questions {evidence}."
    if equivalence is None:
        return f"No preference is shown for {whom} {evidence}; this is not evidence that the two are alike."
    inside = f"(p {p_text(equivalence.pvalue)}, where {level / 2:g} is asked of either side)"
    if shown:
        return f"Comparable for {whom}: any preference is below {margin} {inside}."
    return f"No preference is shown for {whom} {evidence}; nor that any is below {margin} {inside}."


def paragraph(analysis: Analysis, question: QuestionAnalysis) -> str:
    """The results of a question, without its verdict."""
    responses, primary = question.responses, question.primary
    levels = {factor: int(codes.max()) + 1 for factor, codes in responses.factors.items()}
    within = [f"{levels[factor]} {factor}" for factor in ("scenes", "styles") if factor in levels]
    text = f"{len(question.by_participant)} participants judged {len(question.by_item)} sets"
    text += f" ({', '.join(within)})" if within else ""
    if responses.ratings:
        ours, theirs = responses.ratings
        text += f" for both methods, {responses.count} pairs of ratings: {ours:.2f} for ours, {theirs:.2f} for theirs."
    else:
        ours, neither, theirs = map(percent, fractions(question))
        text += f", {responses.count} answers: {ours} preferred ours, {neither} neither, {theirs} theirs."
    if primary is not None:
        result, confidence = primary.result, f"{100 * analysis.settings.confidence:g} % interval"
        text += f" The mean preference is {result.estimate:+.2f} points ({confidence} {bounds(result.interval)}"
        text += f", {title_of(primary.name)}, p {p_text(result.pvalue)})."
    sizes = [f"{title_of(one.name)} {one.estimate:.2f} {bounds(one.interval)}" for one in question.effects]
    return f"{text} {'; '.join(sizes).capitalize()}."


def registered(analysis: Analysis) -> list[str]:
    """The design, the exclusion rules and the analysis options, one paragraph each."""
    settings, rules, study = analysis.settings, analysis.settings.rules, analysis.settings.study
    lines = []
    if study is not None:
        plan, asked = study.plan, [f"{item.name} ({item.kind}): “{item.text}”" for item in study.plan.questions]
        lines.append(
            f"Design {study.id}, drawn with seed {plan.seed}: {plan.participants} participants, {plan.sets} of "
            f"{len(study.items)} sets each, {study.compared}; {plan.degraded} degraded and "
            f"{plan.repeats} repeated sets each as attention checks. {'; '.join(asked)}."
        )
    excluded = list[str]()
    if rules.missing_share < 1:
        excluded.append(f"miss more than {percent(rules.missing_share)} of the answers they were assigned")
    if rules.failed_checks is not None:
        excluded.append(f"fail more than {rules.failed_checks} attention checks")
    if rules.min_seconds:
        fast = f"in less than {rules.min_seconds:g} s"
        excluded.append(f"answer more than {percent(rules.fast_share)} of the sets {fast}")
    if rules.straight_lining:
        excluded.append("give one answer throughout every question")
    first = "Of several answers to one question the first that is not empty counts."
    changed = " These rules are not the design's." if study is not None and rules != study.plan.rules else ""
    who = f"Participants are excluded who {' or '.join(excluded)}." if excluded else "No rule excludes participants."
    lines.append(f"{who} {first}{changed}")
    margin = "No equivalence margin was set."
    if settings.margin is not None:
        way = f"{percent(settings.margin)} of the way from neutral to the end of the scale"
        margin = f"A mean within {way} counts as no preference."
    lines.append(
        f"Tests and intervals are {_CLAIMS[settings.alternative]}, at {100 * settings.confidence:g} %; p-values are "
        f"adjusted over the questions by Holm's method. {margin} Negative means that ours is preferred."
    )
    return lines


def took_part(analysis: Analysis) -> str:
    """Number of participants and answers, read and analysed."""
    checks = analysis.checks
    rules = [exclusion.rule for exclusion in checks.exclusions]
    why = "; ".join(f"{rules.count(rule)} for {rule}" for rule in dict.fromkeys(rules))
    because = f" ({why})" if why else ""
    return (
        f"{checks.participants_read} participants gave {checks.answers_read} answers, {checks.attention_answers} of "
        f"them to attention checks. {len(rules) or 'None'} {'were' if len(rules) != 1 else 'was'} left out"
        f"{because}; {checks.answers_used} answers of {checks.participants_read - len(rules)} are "
        f"analysed. {_missing(analysis).lstrip()}".rstrip()
    )


def _missing(analysis: Analysis) -> str:
    """Which answers are missing or outside of the scale, and who of the design gave none."""
    lacking, study = analysis.checks.missing, analysis.settings.study
    text = "" if study is None else "No answer is missing."  # without a design, rows may be missing
    if lacking:
        totals: Counter[str] = sum(map(Counter, lacking.values()), Counter())
        people = "; ".join(f"{person}: {_counts(counts)}" for person, counts in lacking.items())
        text = f"{totals.total()} answers are missing ({_counts(totals)}), of {people}."
    if outside := [finding.participant for finding in analysis.checks.of_kind("out_of_range")]:
        people = ", ".join(dict.fromkeys(outside))
        text += f" Those outside of the scale count as missing: {len(outside)}, of {people}."
    present = {answer.participant.partition("-")[0] for answer in analysis.records.answers}
    if absent := [one.id for one in (study.participants if study else ()) if one.id not in present]:
        text += f" Nobody answered as {', '.join(absent)}."
    return text


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{question} {count}" for question, count in counts.items())


def response_level(analysis: Analysis) -> str:
    """What the response-level tests are worth in this study."""
    comparison = "response-level p-values are given for comparison with published ones"
    rates = [question.variation.naive_error_rate for question in analysis.questions if question.variation is not None]
    people = min((len(question.by_participant) for question in analysis.questions), default=0)
    if not rates or people < _MIN_PEOPLE:
        return f"{people} participants are too few to show how much people differ: {comparison} only."
    low, high = percent(min(rates)), percent(max(rates))
    span = high if low == high else f"{low.removesuffix(' %')} to {high}"
    return (
        "The response-level test counts every answer as an independent one: with the variation seen here it would "
        f"report a preference that does not exist in {span} of such studies instead of 5 %. {comparison.capitalize()}; "
        "conclusions rest on the tests over participants and sets."
    )
