"""The findings in sentences."""

import math

import numpy as np

from anystyle.study.analysis import Analysis, NamedResult, QuestionAnalysis
from anystyle.study.tabulate import p_text

_LEVEL = 0.05


def fractions(question: QuestionAnalysis) -> tuple[float, float, float]:
    """The shares of answers that prefer ours, neither and theirs."""
    signs = np.sign(question.responses.deviations)
    return float(np.mean(signs < 0)), float(np.mean(signs == 0)), float(np.mean(signs > 0))


def verdict(question: QuestionAnalysis) -> str:
    """What may be concluded, for whom, in one sentence."""
    primary = question.primary
    if primary is None:
        notes = [named.result.note for named in question.tests if named.result.note]
        return f"No conclusion is possible: {notes[0] if notes else 'no test was made'}."
    result = primary.result
    whom = " and ".join(f"new {group}" for group in result.generalizes_to)
    adjusted = math.exp(primary.log_pvalue_holm)
    evidence = f"(p {p_text(adjusted)}, adjusted over the questions)"
    low, high = result.interval
    if adjusted <= _LEVEL and result.estimate < 0:
        return f"Ours is preferred, and this holds for {whom} {evidence}."
    if low > 0:
        return f"Theirs is preferred, and this holds for {whom}: the interval lies above 0."
    if high < 0:
        return f"Ours seems preferred: the interval lies below 0, but the adjusted test does not confirm it {evidence}."
    return f"No preference is shown for {whom} {evidence}; that is not yet evidence that the two are alike."


def equivalence(question: QuestionAnalysis) -> str:
    """What the equivalence tests say, in one sentence; empty where there are none."""
    tests = [named for named in question.tests if named.result.alternative == "equivalence"]
    usable = [named for named in tests if math.isfinite(named.result.log_pvalue)]
    if not usable:
        return ""
    parts = [f"p {p_text(named.result.pvalue)} over {named.result.unit}s" for named in usable]
    shown = all(named.result.pvalue <= _LEVEL for named in usable)
    lead = "Comparable within the margin" if shown else "Not shown to be comparable within the margin"
    return f"{lead} ({usable[0].result.method.partition(', ')[2]}): {'; '.join(parts)}."


def percent(fraction: float) -> str:
    """A share as people write it."""
    return f"{100 * fraction:.0f} %"


def response_level(analysis: Analysis) -> str:
    """Whether the response-level test keeps its promise here, in one sentence."""
    rates = [q.variation.naive_error_rate for q in analysis.questions if q.variation is not None]
    if not rates:
        return "The answers do not vary enough to judge the response-level tests."
    if max(rates) <= 0.065:
        return (
            "In this study participants and items hardly differ, so that the response-level tests happen to hold "
            f"(false positives about {percent(max(rates))} at a nominal 5 %); those below need not rely on that."
        )
    low, high = percent(min(rates)), percent(max(rates))
    span = high if low == high else f"{low.removesuffix(' %')} to {high}"
    return (
        f"The response-level test fails here: it would report a preference that does not exist in {span} of such "
        "studies instead of 5 %, because it counts every answer of a person as an independent one. Its p-values are "
        "given for comparison with published ones; conclusions rest on the tests over participants and items."
    )


def is_naive(named: NamedResult) -> bool:
    """Whether a result stands for nobody but those who answered."""
    return not named.result.generalizes_to
