"""The findings for people: a results section in Markdown and in LaTeX, and one page that needs nothing else."""

import base64
import io
import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template

from PIL import Image

import anystyle.study.figures as draw
from anystyle.study.analysis import Analysis, QuestionAnalysis
from anystyle.study.protocol import PICTURES, Item, Study
from anystyle.study.tabulate import (
    bounds,
    effect_title,
    escape_markdown,
    escape_tex,
    holds_for,
    p_text,
    plain_p,
    title_of,
)
from anystyle.study.verdicts import (
    fractions,
    is_naive,
    paragraph,
    percent,
    registered,
    response_level,
    took_part,
    verdict,
)

HEAD = ("test", "unit", "n", "estimate", "interval", "p", "p (Holm)", "effect", "holds for")


def rows_of(question: QuestionAnalysis) -> list[list[str]]:
    """Every test of a question, as cells."""
    rows = []
    for named in question.tests:
        result = named.result
        effect = f"{effect_title(result.effect_name)} {result.effect:.2f}" if result.effect_name else "—"
        effect += f" {bounds(result.effect_interval)}" * (not math.isnan(result.effect_interval[0]))
        holm = p_text(math.exp(named.log_pvalue_holm)).removeprefix("= ")
        rows.append(
            [
                title_of(named.name),
                result.unit,
                str(result.n),
                f"{result.estimate:.3f}" + f" {result.estimate_unit}" * (result.estimate_unit != "points"),
                # Of single answers, which stand for nobody, an interval would cover nothing.
                bounds(result.interval) if result.generalizes_to else "—",
                plain_p(named),
                holm,
                effect,
                "; ".join(filter(None, [holds_for(result.generalizes_to), result.note])),
            ]
        )
    return rows


def markdown(analysis: Analysis) -> str:
    """The section in Markdown: the plan, who took part, and each question with its tests."""
    escape = escape_markdown
    parts = ["## User study", *map(escape, [*registered(analysis), took_part(analysis)])]
    for question in analysis.questions:
        parts += [f"### {escape(question.title)}", escape(paragraph(analysis, question))]
        rows = [HEAD, ["---" if column in (0, 1, 7, 8) else "---:" for column in range(len(HEAD))]]
        rows += [[escape(cell) for cell in row] for row in rows_of(question)]
        parts.append("\n".join("| " + " | ".join(row) + " |" for row in rows))
    return "\n\n".join([*parts, escape(response_level(analysis))]) + "\n"


def latex(analysis: Analysis) -> str:
    """The same in LaTeX, with ``booktabs`` tables."""
    parts = ["% needs \\usepackage{booktabs}", "\\subsection*{User study}"]
    parts += [_tex(text) for text in (*registered(analysis), took_part(analysis))]
    for question in analysis.questions:
        parts += [f"\\paragraph{{{_tex(question.title)}}}", _tex(paragraph(analysis, question))]
        rows = [" & ".join(map(_tex, row)) + " \\\\" for row in (HEAD, *rows_of(question))]
        table = ["\\begin{tabular}{llrrrrrll}", "\\toprule", rows[0], "\\midrule", *rows[1:], "\\bottomrule"]
        parts.append("\n".join([*table, "\\end{tabular}"]))
    return "\n\n".join([*parts, _tex(response_level(analysis))]) + "\n"


def _tex(text: str) -> str:
    """Text with its powers of ten and minus signs as LaTeX writes them."""
    powers = re.sub(r"\b(\d(?:\.\d+)?)e(-?)0*(\d+)\b", r"$\1 \\times 10^{\2\3}$", escape_tex(text))
    return re.sub(r"(?<=[\s\[(])-(?=\d)|^-(?=\d)", r"$-$", powers)


_LISTED = 60  # rows of a list of findings; the rest is in analysis.json
_CHECKS = {
    "failed_attention_check": "Failed attention checks",
    "fast": "Sets answered too fast",
    "duplicated": "Sets answered twice",
    "out_of_range": "Answers outside the scale",
    "straight_lining": "One answer throughout",
    "missing": "Missing answers",
}


def page_text(name: str) -> str:
    """A file that comes with the package's pages."""
    return (files("anystyle.study") / "pages" / name).read_text(encoding="utf-8")


def html(analysis: Analysis, title: str = "User study", folder: Path | None = None) -> str:
    """The report as one HTML page; ``folder`` is the design's, for its pictures."""
    questions, confidence = analysis.questions, 100 * analysis.settings.confidence
    return Template(page_text("report.html")).substitute(
        title=escape(title),
        style=page_text("report.css"),
        plan="".join(f"<p>{escape(text)}</p>" for text in registered(analysis)),
        took_part=escape(took_part(analysis)),
        cards="\n".join(_card(analysis, question) for question in questions),
        likert=draw.as_svg(draw.likert(analysis), "likert"),
        headline=escape(response_level(analysis)),
        inflation=_inflation(questions),
        tests="\n".join(_tests(analysis, question) for question in questions),
        means=draw.as_svg(draw.means(analysis), "means"),
        confidence=f"{confidence:g}",
        sets=_sets(analysis, folder),
        agreement=_agreement(questions),
        effects=_effects(questions, confidence),
        positions=_positions(analysis),
        checks=_checks(analysis),
        comments=_comments(analysis),
        footer=escape(f"anystyle {version('anystyle')}. Files: {', '.join(analysis.sources)}."),
    )


def _card(analysis: Analysis, question: QuestionAnalysis) -> str:
    ours, neither, theirs = fractions(question)
    bars = "".join(
        f'<i style="width:{100 * fraction:.2f}%;background:{color}"></i>'
        for fraction, color in ((ours, draw.OURS), (neither, draw.NEUTRAL), (theirs, draw.THEIRS))
    )
    mean = float(question.responses.deviations.mean())
    return (
        f'<article class="card"><h3>{escape(question.title)}</h3><div class="value">{mean:+.2f} <small>points</small>'
        f'</div><div class="shares" aria-hidden="true">{bars}</div>'
        f"<p><strong>{escape(verdict(analysis, question))}</strong></p>"
        f"<p>{escape(paragraph(analysis, question).removesuffix(verdict(analysis, question)))}</p></article>"
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


def _inflation(questions: Sequence[QuestionAnalysis]) -> str:
    """What it costs to count every answer as independent, with this study's own figures."""
    rows, factors = [], ("participants", "items", "scenes", "styles", "answers")
    for question in questions:
        varies, answers = question.variation, question.responses.count
        if varies is None:
            continue
        spreads = [f"{varies.sds[name]:.2f}" if name in varies.sds else "—" for name in factors]
        worth = f"{varies.effective_answers:.0f} of {answers}"
        rows.append(("", [question.title, *spreads, worth, percent(varies.naive_error_rate)]))
    head = ["question", "SD between participants", "sets", "scenes", "styles", "rest"]
    head += ["independent answers", "false positives"]
    note = (
        "As how many independent answers the study counts, and how often a response-level t test at 5 % would find a "
        "preference in a study that varies like this one and has none (normal approximation)."
    )
    return _table(head, rows, tuple(range(1, 8))) + f'<p class="note">{note}</p>' if rows else ""


def _tests(analysis: Analysis, question: QuestionAnalysis) -> str:
    order = sorted(question.tests, key=lambda named: (is_naive(named), -len(named.result.generalizes_to)))
    cells = dict(zip(map(id, question.tests), rows_of(question), strict=True))
    rows = [
        ("naive" if is_naive(named) else "primary" if named == question.primary else "", cells[id(named)])
        for named in order
    ]
    methods = "".join(
        f"<li>{escape(title_of(named.name))}, {named.result.unit}s: {escape(named.result.method)}</li>"
        for named in question.tests
    )
    head = [*HEAD[:4], f"{100 * analysis.settings.confidence:g} % interval", *HEAD[5:]]
    return (
        f"<h3>{escape(question.title)}</h3>{_table(head, rows, (2, 3, 4, 5, 6))}"
        f"<details><summary>How each was computed</summary><ul>{methods}</ul></details>"
    )


def _sets(analysis: Analysis, folder: Path | None) -> str:
    study = analysis.settings.study
    if study is None or folder is None:
        return ""
    shown = "\n".join(gallery(question, study, folder) for question in analysis.questions)
    return f"<section><h2>Sets</h2>{shown}</section>"


def _agreement(questions: Sequence[QuestionAnalysis]) -> str:
    rows = [("", [q.title, "—" if math.isnan(q.alpha) else f"{q.alpha:.3f}"]) for q in questions]
    note = "Krippendorff's alpha (ordinal): 1 where all participants agree on a set, 0 where they agree as by chance."
    return f'<p class="note">{note}</p>' + _table(["question", "alpha"], rows, (1,))


def _effects(questions: Sequence[QuestionAnalysis], confidence: float) -> str:
    names = list(dict.fromkeys(effect.name for question in questions for effect in question.effects))
    rows = []
    for question in questions:
        texts = {effect.name: f"{effect.estimate:.2f} {bounds(effect.interval)}" for effect in question.effects}
        rows.append(("", [question.title, *(texts.get(name, "—") for name in names)]))
    note = (
        "Over all answers; intervals take participants, sets, scenes and styles as drawn at random. "
        "Probability of superiority: how often an answer "
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
    lines = [f"<p>{escape(note)}</p>" for note in checks.notes]
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


_EXTREMES = 3
_LARGE, _SMALL = 220, 72  # pixels of the longer side


def gallery(question: QuestionAnalysis, study: Study, folder: Path) -> str:
    """HTML: ours' best and worst sets of a question with their pictures, then every set by its mean."""
    items = {item.id: item for item in study.items}
    side = question.by_item
    ranked = sorted(zip(side.names, side.means.tolist(), side.half_width.tolist(), strict=True), key=lambda row: row[1])
    ranked = [row for row in ranked if row[0] in items]
    extremes = min(_EXTREMES, len(ranked) // 2)
    groups = (("Best for ours", ranked[:extremes]), ("Worst for ours", ranked[len(ranked) - extremes :][::-1]))
    large = "".join(
        f"<h4>{title}</h4>"
        + "".join(_pictures(study, items[name], mean, half_width, folder) for name, mean, half_width in rows)
        for title, rows in groups
    )
    rows = "".join(
        f"<tr><td>{_image(folder, items[name].ours, _SMALL, study.ours)}"
        f"{_image(folder, items[name].theirs, _SMALL, items[name].baseline)}</td>"
        f"<td>{escape(items[name].scene)}</td><td>{escape(items[name].style)}</td>"
        f"<td>{escape(items[name].baseline)}</td>"
        f'<td class="number">{_mean(mean, half_width)}</td></tr>'
        for name, mean, half_width in ranked
    )
    head = "<tr><th>ours, theirs</th><th>scene</th><th>style</th><th>against</th><th>mean, from neutral</th></tr>"
    table = f'<div class="scroll"><table><thead>{head}</thead><tbody>{rows}</tbody></table></div>'
    return (
        f"<h3>{escape(question.title)}</h3>{large}"
        f"<details><summary>All {len(ranked)} sets, best for ours first</summary>{table}</details>"
    )


def _mean(mean: float, half_width: float) -> str:
    return f"{mean:+.2f}".replace("-", "−") + (f" ± {half_width:.2f}" if math.isfinite(half_width) else "")


def _pictures(study: Study, item: Item, mean: float, half_width: float, folder: Path) -> str:
    reference = (item.reference,) if item.reference else ()
    shown = (("photograph", item.content), ("style", reference), (study.ours, item.ours), (item.baseline, item.theirs))
    figures = "".join(
        f"<div>{_image(folder, files, _LARGE, name)}<small>{escape(name)}</small></div>"
        for name, files in shown
        if files
    )
    words = f"<div><q>{escape(item.text)}</q><small>style</small></div>" * bool(item.text)
    caption = f"{escape(item.scene)}, {escape(item.style)}: {_mean(mean, half_width)} points"
    return f'<figure class="set"><div class="views">{figures}{words}</div><figcaption>{caption}</figcaption></figure>'


def _image(folder: Path, files: tuple[str, ...], longest: int, name: str) -> str:
    """The middle view, small, inside the page; a video's poster. Nothing where the file is not there."""
    file = (folder / PICTURES / files[len(files) // 2]).with_suffix(".jpg")
    if not file.is_file():
        return ""
    with Image.open(file) as picture:
        small = picture.convert("RGB")
    small.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    data = io.BytesIO()
    small.save(data, "JPEG", quality=82)
    source = f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"
    return f'<img alt="{escape(name)}" width="{small.width}" height="{small.height}" src="{source}">'
