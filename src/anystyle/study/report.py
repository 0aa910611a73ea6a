"""The findings as one page that needs nothing else: figures are inline, all text is escaped."""

import math
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import version
from importlib.resources import files
from string import Template

import anystyle.study.figures as draw
from anystyle.study.analysis import Analysis, QuestionAnalysis
from anystyle.study.tabulate import effect_title, generalizes, p_text, plain_p, title_of
from anystyle.study.verdicts import equivalence, fractions, is_naive, percent, response_level, verdict

_LISTED = 60  # rows of a list of findings; the rest is in analysis.json
_CHECKS = {
    "failed_attention_check": "Failed attention checks",
    "duplicated": "Sets answered twice",
    "out_of_range": "Answers outside the scale",
    "straight_lining": "One answer throughout",
    "missing": "Missing answers",
}


def page_text(name: str) -> str:
    """A file that comes with the package's pages."""
    return (files("anystyle.study") / "pages" / name).read_text(encoding="utf-8")


def html(analysis: Analysis, title: str = "User study") -> str:
    """The report as one HTML page."""
    questions, confidence = analysis.questions, 100 * analysis.settings.confidence
    return Template(page_text("report.html")).substitute(
        title=escape(title),
        style=page_text("report.css"),
        summary=escape(_summary(analysis)),
        cards="\n".join(_card(question, confidence) for question in questions),
        likert=draw.as_svg(draw.likert(analysis), "likert"),
        headline=escape(response_level(analysis)),
        inflation=_inflation(questions),
        tests="\n".join(_tests(question, confidence) for question in questions),
        means=draw.as_svg(draw.means(analysis), "means"),
        confidence=f"{confidence:g}",
        agreement=_agreement(questions, confidence),
        effects=_effects(questions, confidence),
        positions=_positions(analysis),
        checks=_checks(analysis),
        comments=_comments(analysis),
        footer=_footer(analysis),
    )


def _summary(analysis: Analysis) -> str:
    people = {name for question in analysis.questions for name in question.by_participant.names}
    items = {name for question in analysis.questions for name in question.by_item.names}
    excluded = len(analysis.checks.exclusions)
    return (
        f"{len(people)} participants, {len(items)} items, {len(analysis.questions)} questions, "
        f"{analysis.checks.answers_used} answers; {excluded or 'no'} participant{'s' * (excluded != 1)} excluded. "
        f"Scale {analysis.settings.scale.low:g} to {analysis.settings.scale.high:g}, "
        f"{analysis.settings.scale.midpoint:g} is neutral; lower and negative values prefer ours."
    )


def _card(question: QuestionAnalysis, confidence: float) -> str:
    ours, neither, theirs = fractions(question)
    primary = question.primary
    interval = "" if primary is None else f"[{primary.result.interval[0]:.2f}, {primary.result.interval[1]:.2f}]"
    bars = "".join(
        f'<i style="width:{100 * fraction:.2f}%;background:{color}"></i>'
        for fraction, color in ((ours, draw.OURS), (neither, draw.NEUTRAL), (theirs, draw.THEIRS))
    )
    mean = float(question.responses.deviations.mean())
    return (
        f'<article class="card"><h3>{escape(question.title)}</h3>'
        f'<div class="value">{mean:+.2f} <small>points {interval}, {confidence:g} %</small></div>'
        f'<div class="shares" aria-hidden="true">{bars}</div>'
        f"<p>{percent(ours)} prefer ours, {percent(neither)} neither, {percent(theirs)} theirs.</p>"
        f"<p><strong>{escape(verdict(question))}</strong></p><p>{escape(equivalence(question))}</p></article>"
    )


def _table(head: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]], numbers: Sequence[int]) -> str:
    """A table; rows are a CSS class and plain text cells."""

    def cell(tag: str, column: int, text: str) -> str:
        number = ' class="number"' if column in numbers else ""
        return f"<{tag}{number}>{escape(text)}</{tag}>"

    body = "\n".join(
        f'<tr class="{name}">' + "".join(cell("td", column, text) for column, text in enumerate(row)) + "</tr>"
        for name, row in rows
    )
    header = "".join(cell("th", column, text) for column, text in enumerate(head))
    return f'<div class="scroll"><table><thead><tr>{header}</tr></thead><tbody>\n{body}\n</tbody></table></div>'


def _bounds(bounds: tuple[float, float]) -> str:
    return "" if math.isnan(bounds[0]) else f"[{bounds[0]:.2f}, {bounds[1]:.2f}]"


def _inflation(questions: Sequence[QuestionAnalysis]) -> str:
    """What it costs to count every answer as independent, with this study's own figures."""
    rows = []
    for question in questions:
        varies, answers = question.variation, question.responses.count
        if varies is None:
            continue
        spreads = [f"{sd:.2f}" for sd in (varies.participant_sd, varies.item_sd, varies.residual_sd)]
        worth = f"{varies.effective_answers:.0f} of {answers}"
        rows.append(("", [question.title, *spreads, worth, percent(varies.naive_error_rate)]))
    head = ["question", "SD between participants", "between items", "rest", "independent answers", "false positives"]
    note = (
        "As how many independent answers the study counts, and how often a response-level t test at 5 % would find a "
        "preference in a study that varies like this one and has none (normal approximation)."
    )
    return _table(head, rows, (1, 2, 3, 4, 5)) + f'<p class="note">{note}</p>' if rows else ""


def _tests(question: QuestionAnalysis, confidence: float) -> str:
    level = confidence / 100
    rows: list[tuple[str, Sequence[str]]] = []
    for named in sorted(question.tests, key=lambda named: (is_naive(named), -len(named.result.generalizes_to))):
        result = named.result
        effect = f"{effect_title(result.effect_name)} {result.effect:.2f}" if result.effect_name else ""
        style = "naive" if is_naive(named) else "primary" if named == question.primary else ""
        rows.append(
            (
                style,
                [
                    title_of(named.name),
                    f"{result.n} {result.unit}s",
                    f"{result.estimate:+.3f}" + f" {result.estimate_unit}" * (result.estimate_unit != "points"),
                    _bounds(result.interval) + f" ({100 * result.confidence:.0f} %)" * (result.confidence != level),
                    plain_p(named),
                    "n/a"
                    if math.isnan(named.log_pvalue_holm)
                    else p_text(math.exp(named.log_pvalue_holm)).lstrip("= "),
                    effect,
                    result.note or generalizes(named),
                ],
            )
        )
    head = ["test", "counts", "estimate", f"{confidence:g} % interval", "p", "p (Holm)", "effect", "holds for"]
    methods = "".join(
        f"<li>{escape(title_of(named.name))}, {named.result.unit}s: {escape(named.result.method)}"
        f"; {escape(named.result.alternative)}</li>"
        for named in question.tests
    )
    return (
        f"<h3>{escape(question.title)}</h3>{_table(head, rows, (2, 3, 4, 5))}"
        f"<details><summary>How each was computed</summary><ul>{methods}</ul></details>"
    )


def _agreement(questions: Sequence[QuestionAnalysis], confidence: float) -> str:
    rows = [
        ("", [q.title, "n/a" if math.isnan(q.alpha) else f"{q.alpha:.3f}", _bounds(q.alpha_interval)])
        for q in questions
    ]
    note = "Krippendorff's alpha (ordinal): 1 where all participants agree on an item, 0 where they agree as by chance."
    return f'<p class="note">{note}</p>' + _table(["question", "alpha", f"{confidence:g} % interval"], rows, (1, 2))


def _effects(questions: Sequence[QuestionAnalysis], confidence: float) -> str:
    names = [effect.name for effect in questions[0].effects]
    rows = [
        ("", [question.title, *(f"{effect.estimate:.2f} {_bounds(effect.interval)}" for effect in question.effects)])
        for question in questions
    ]
    note = (
        "Over all answers; intervals resample participants and items. Probability of superiority: how often an answer "
        "prefers ours, ties counted half."
    )
    head = ["question", *(f"{effect_title(name)} [{confidence:g} %]" for name in names)]
    return _table(head, rows, tuple(range(1, len(head)))) + f'<p class="note">{note}</p>'


def _positions(analysis: Analysis) -> str:
    if not any(question.position is not None for question in analysis.questions):
        return "<p>Ours was always shown on one side: a lean to a side cannot be told from a preference.</p>"
    figure = draw.as_svg(draw.positions(analysis), "positions")
    caption = (
        "The mean answer where ours was shown as A and where it was shown as B, positions undone: without a lean to a "
        "side they agree. The lean is what remains of the answers as displayed when both positions count alike."
    )
    return f"<figure>{figure}<figcaption>{caption}</figcaption></figure>"


def _checks(analysis: Analysis) -> str:
    checks = analysis.checks
    lines = [
        f"<p>{checks.answers_read} answers were read, {checks.attention_answers} of them to attention checks; "
        f"{checks.answers_used} are analysed.</p>"
    ]
    lines += [f"<p>{escape(note)}</p>" for note in checks.notes]
    excluded = [("", [item.participant, item.rule, item.detail]) for item in checks.exclusions]
    if excluded:
        lines.append("<h3>Excluded participants</h3>" + _table(["participant", "rule", "detail"], excluded, ()))
    else:
        lines.append("<p>No participant was excluded.</p>")
    for kind, name in _CHECKS.items():
        findings = [item for item in checks.findings if item.kind == kind]
        if not findings:
            continue
        rows = [("", [item.participant, item.detail]) for item in findings[:_LISTED]]
        more = f"<p class='note'>and {len(findings) - _LISTED} more, in analysis.json</p>" * (len(findings) > _LISTED)
        table = _table(["participant", "detail"], rows, ())
        lines.append(f"<details><summary>{name}: {len(findings)}</summary>{table}{more}</details>")
    clean = [name.lower() for kind, name in _CHECKS.items() if not checks.count(kind)]
    if clean:
        lines.append(f'<p class="note">None found: {", ".join(clean)}.</p>')
    return "\n".join(lines)


def _comments(analysis: Analysis) -> str:
    if not analysis.comments:
        return ""
    quotes = "".join(f"<blockquote>{escape(person)}: {escape(text)}</blockquote>" for person, text in analysis.comments)
    return f"<section><h2>Comments</h2>{quotes}</section>"


def _footer(analysis: Analysis) -> str:
    rules, settings = analysis.settings.rules, analysis.settings
    text = (
        f"anystyle {version('anystyle')}. Files: {', '.join(analysis.sources)}. Seed {settings.seed}. Participants are "
        f"left out who failed more than {rules.failed_checks} attention checks or miss more than "
        f"{percent(rules.missing_share)} of the answers{', or gave one answer throughout' * rules.straight_lining}. "
        "Of several answers to one set the first counts. Holm's adjustment is over the questions, for each test."
    )
    return f"<p>{escape(text)}</p>"
