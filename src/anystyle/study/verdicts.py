"""The findings in sentences."""

import math

import numpy as np

from anystyle.study.analysis import Analysis, NamedResult, QuestionAnalysis
from anystyle.study.tabulate import bounds, effect_title, holds_for, p_text

_CLAIMS = {"two-sided": "two-sided", "less": "one-sided (ours is preferred)", "greater": "one-sided (theirs is)"}
_TOO_FEW = 10  # participants, from whom nobody can tell how far people differ


def fractions(question: QuestionAnalysis) -> tuple[float, float, float]:
    """The shares of answers that prefer ours, neither and theirs."""
    signs = np.sign(question.responses.deviations)
    return float(np.mean(signs < 0)), float(np.mean(signs == 0)), float(np.mean(signs > 0))


def verdict(analysis: Analysis, question: QuestionAnalysis) -> str:
    """What may be concluded, for whom, in one sentence; never both a preference and its absence."""
    primary = question.primary
    if analysis.checks.doubt:
        return f"No conclusion is possible: {analysis.checks.doubt}."
    if primary is None:
        notes = [named.result.note for named in question.tests if named.result.note]
        return f"No conclusion is possible: {notes[0] if notes else 'no test speaks of new participants'}."
    result, level = primary.result, 1 - analysis.settings.confidence
    whom, adjusted = holds_for(result.generalizes_to), math.exp(primary.log_pvalue_holm)
    evidence = f"(p {p_text(adjusted)}, adjusted over the questions)"
    equivalence = question.equivalence
    if adjusted <= level and result.estimate != 0:
        side = "Ours" if result.estimate < 0 else "Theirs"
        small = equivalence is not None and equivalence.shown
        by = f", by less than the margin of {equivalence.margin:.2g} points" if equivalence and small else ""
        return f"{side} is preferred{by}, and this holds for {whom} {evidence}."
    low, high = result.interval
    if low > 0 or high < 0:
        return f"A preference is indicated for {whom}, but not confirmed over all questions {evidence}."
    if equivalence is not None and equivalence.shown:
        inside = f"(p {p_text(equivalence.pvalue)})"
        return f"Comparable for {whom}: any preference is below the margin of {equivalence.margin:.2g} points {inside}."
    alike = "that is not yet evidence that the two are alike"
    if equivalence is not None:
        alike = f"nor that any is below the margin of {equivalence.margin:.2g} points (p {p_text(equivalence.pvalue)})"
    return f"No preference is shown for {whom} {evidence}; {alike}."


def paragraph(analysis: Analysis, question: QuestionAnalysis) -> str:
    """A question's results, as a paper has them."""
    responses, primary = question.responses, question.primary
    confidence = f"{100 * analysis.settings.confidence:g} %"
    levels = {factor: int(codes.max()) + 1 for factor, codes in responses.factors.items()}
    within = [f"{levels[factor]} {factor}" for factor in ("scenes", "styles") if factor in levels]
    text = f"{len(question.by_participant.names)} participants judged {len(question.by_item.names)} sets"
    text += f" ({', '.join(within)})" if within else ""
    if responses.ratings:
        ours, theirs = responses.ratings
        text += f" for both methods, {responses.count} pairs of ratings: {ours:.2f} for ours, {theirs:.2f} for theirs."
    else:
        ours, neither, theirs = (percent(fraction) for fraction in fractions(question))
        text += f", {responses.count} answers: {ours} preferred ours, {neither} neither, {theirs} theirs."
    if primary is not None:
        result = primary.result
        text += (
            f" The mean preference is {result.estimate:+.2f} points ({confidence} interval {bounds(result.interval)}"
        )
        text += f", {primary.name.replace('_', ' ')}, p {p_text(result.pvalue, result.log10_pvalue)})."
    effects = [
        f"{effect_title(effect.name)} {effect.estimate:.2f} {bounds(effect.interval)}" for effect in question.effects
    ]
    return f"{text} {'; '.join(effects).capitalize()}. {verdict(analysis, question)}"


def registered(analysis: Analysis) -> list[str]:
    """What was fixed before there were answers, and how it was analysed."""
    settings, rules, study = analysis.settings, analysis.settings.rules, analysis.settings.study
    lines = []
    if study is not None:
        plan, asked = study.plan, [f"{item.name} ({item.kind}): “{item.text}”" for item in study.plan.questions]
        lines.append(
            f"Design {study.id}, drawn with seed {plan.seed}: {plan.participants} participants, {plan.sets} of "
            f"{len(study.items)} sets each, {study.ours} against {', '.join(study.baselines)}; "
            f"{plan.degraded} degraded and {plan.repeats} repeated sets each as attention checks. {'; '.join(asked)}."
        )
    left_out = [f"miss more than {percent(rules.missing_share)} of the answers they were assigned"]
    if rules.failed_checks is not None:
        left_out.append(f"fail more than {rules.failed_checks} attention checks")
    if rules.min_seconds:
        left_out.append(
            f"answer more than {percent(rules.fast_share)} of the sets in less than {rules.min_seconds:g} s"
        )
    if rules.straight_lining:
        left_out.append("give one answer throughout")
    lines.append(
        f"Left out are participants who {' or '.join(left_out)}. Of several answers to one question the first counts."
        + " These rules are not the design's." * (study is not None and rules != study.plan.rules)
    )
    margin = "No margin of equivalence was set."
    if settings.margin is not None:
        margin = (
            f"A mean within {percent(settings.margin)} of the way from neutral to the scale's end is no preference."
        )
    lines.append(
        f"Tests and intervals are {_CLAIMS[settings.alternative]}, at {100 * settings.confidence:g} %; p-values are "
        f"adjusted over the questions by Holm's method. {margin} Negative means that ours is preferred."
    )
    return lines


def took_part(analysis: Analysis) -> str:
    """Who answered, and who of them is analysed."""
    checks = analysis.checks
    rules = [exclusion.rule for exclusion in checks.exclusions]
    why = "; ".join(f"{rules.count(rule)} for {rule}" for rule in dict.fromkeys(rules))
    kept = checks.participants_read - len(rules)
    return (
        f"{checks.participants_read} participants gave {checks.answers_read} answers, {checks.attention_answers} of "
        f"them to attention checks. {len(rules) or 'None'} {'were' if len(rules) != 1 else 'was'} left out"
        f"{f' ({why})' * bool(why)}; {checks.answers_used} answers of {kept} are analysed."
    )


def percent(fraction: float) -> str:
    """A share as people write it."""
    return f"{100 * fraction:.0f} %"


def response_level(analysis: Analysis) -> str:
    """What the response-level test does here, in one sentence."""
    rates = [q.variation.naive_error_rate for q in analysis.questions if q.variation is not None]
    people = min((len(question.by_participant.names) for question in analysis.questions), default=0)
    if not rates or people < _TOO_FEW:
        return (
            f"From {people} participants nobody can tell how far people differ: response-level p-values are given for "
            "comparison with published ones, and nothing follows from them."
        )
    low, high = percent(min(rates)), percent(max(rates))
    span = high if low == high else f"{low.removesuffix(' %')} to {high}"
    return (
        f"The response-level test counts every answer as an independent one: by the variation seen here it would "
        f"report a preference that does not exist in {span} of such studies instead of 5 %. Its p-values are given for "
        "comparison with published ones; conclusions rest on the tests over participants and sets."
    )


def is_naive(named: NamedResult) -> bool:
    """Whether a result stands for nobody but those who answered."""
    return not named.result.generalizes_to
