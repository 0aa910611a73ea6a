"""The report: a section in Markdown and in LaTeX, and one self-contained HTML page, from the same blocks."""

import math
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from PIL import Image

from anystyle.evaluation.tables import Table, escape_latex, escape_markdown
from anystyle.io.sheet import data_url
from anystyle_study import figures, wording
from anystyle_study.analysis import Analysis, Mean, NamedResult, QuestionAnalysis
from anystyle_study.checks import KINDS
from anystyle_study.protocol import PICTURES, Item, Study
from anystyle_study.wording import bounds, p_text, title_of

PAGES = Path(__file__).parent / "pages"
_MAX_LISTED = 60  # rows of a list of findings; analysis.json has all
_NUM_EXTREMES = 3
_LARGE, _SMALL = 220, 72  # pixels of the longer side


def tests_table(question: QuestionAnalysis, confidence: float) -> Table:
    """Every test of a question, those that generalise to most first."""
    rows = []
    for named in _ordered(question):
        result = named.result
        effect = f"{title_of(result.effect_name)} {result.effect:.2f}" if result.effect_name else "—"
        if not math.isnan(result.effect_interval[0]):
            effect += f" {bounds(result.effect_interval)}"
        estimate = f"{result.estimate:.3f}"
        if result.estimate_unit != "points":
            estimate += f" {result.estimate_unit}"
        # An interval of single answers would have no coverage.
        interval = bounds(result.interval) if result.generalizes_to else "—"
        pvalues = (p_text(value).removeprefix("= ") for value in (result.pvalue, named.pvalue_holm))
        claim = "; ".join(filter(None, [wording.generalization(result.generalizes_to), result.note]))
        rows.append((title_of(named.name), result.unit, str(result.n), estimate, interval, *pvalues, effect, claim))
    level = f"{100 * confidence:g} % interval"
    return Table(("test", "unit", "n", "estimate", level, "p", "p (Holm)", "effect", "generalises to"), tuple(rows))


def _blocks(analysis: Analysis) -> Iterator[tuple[str, str | Table]]:
    """The section: kind (``section``, ``question``, ``text`` or ``table``) and content of each block."""
    yield "section", "User study"
    for text in (*wording.registered(analysis), wording.took_part(analysis)):
        yield "text", text
    for question in analysis.questions:
        yield "question", question.title
        yield "text", f"{wording.paragraph(analysis, question)} {wording.verdict(analysis, question)}"
        yield "table", tests_table(question, analysis.settings.confidence)
    yield "text", wording.response_level(analysis)


def markdown(analysis: Analysis) -> str:
    """The section in Markdown."""
    forms = {"section": "## %s", "question": "### %s", "text": "%s"}
    parts = (
        block.markdown().strip() if isinstance(block, Table) else forms[kind] % escape_markdown(block)
        for kind, block in _blocks(analysis)
    )
    return "\n\n".join(parts) + "\n"


def latex(analysis: Analysis) -> str:
    """The section in LaTeX; needs ``booktabs``."""
    forms = {"section": r"\subsection*{%s}", "question": r"\paragraph{%s}", "text": "%s"}
    parts = [
        block.tabular() if isinstance(block, Table) else forms[kind] % escape_latex(block)
        for kind, block in _blocks(analysis)
    ]
    return "\n\n".join(["% needs \\usepackage{booktabs}", *parts]) + "\n"


def html(analysis: Analysis, title: str = "User study", folder: Path | None = None) -> str:
    """The report as one HTML page; ``folder`` is the designed study, for its pictures."""
    from jinja2 import Environment, FileSystemLoader

    questions, study = analysis.questions, analysis.settings.study
    page = Environment(loader=FileSystemLoader(PAGES), autoescape=True, trim_blocks=True, lstrip_blocks=True)
    page.tests["numeric"] = lambda text: text[:1] in set("0123456789+-−—[<")
    page.globals |= {"wording": wording, "plus_minus": _plus_minus}
    drawn = {"likert": figures.likert(analysis), "means": figures.means(analysis)}
    alphas = ((one.title, f"{one.alpha:.3f}".replace("nan", "—")) for one in questions)
    level = analysis.settings.confidence
    return page.get_template("report.html").render(
        title=title,
        analysis=analysis,
        figures={name: figures.as_svg(figure, name) for name, figure in drawn.items()},
        colors=(figures.OURS, figures.NEUTRAL, figures.THEIRS),
        inflation=_inflation(questions),
        positions=_positions(questions),
        tests=[
            (question, tests_table(question, level), [_class(question, test) for test in _ordered(question)])
            for question in questions
        ],
        agreement=Table(("question", "alpha"), tuple(alphas)),
        study=study,
        galleries=[_gallery(question, study, folder) for question in questions] if study and folder else [],
        findings={kind.replace("_", " ").capitalize(): analysis.checks.of_kind(kind) for kind in KINDS},
        max_listed=_MAX_LISTED,
        version=version("anystyle"),
    )


def _ordered(question: QuestionAnalysis) -> list[NamedResult]:
    """The tests, those that generalise to most first."""
    return sorted(question.tests, key=lambda named: -len(named.result.generalizes_to))


def _class(question: QuestionAnalysis, test: NamedResult) -> str:
    """The CSS class of a test's row."""
    return "primary" if test == question.primary else "" if test.result.generalizes_to else "naive"


def _inflation(questions: Sequence[QuestionAnalysis]) -> Table:
    """Variance components, and the cost of counting every answer as independent."""
    factors = {"participants": "SD between participants", "items": "sets", "scenes": "scenes", "styles": "styles"}
    head = ("question", *factors.values(), "rest", "independent answers", "false positives")
    rows = []
    for question in questions:
        varies = question.variation
        if varies is not None:
            spreads = [f"{varies.sds[name]:.2f}" if name in varies.sds else "—" for name in (*factors, "answers")]
            worth = f"{varies.effective_answers:.0f} of {question.responses.count}"
            rows.append((question.title, *spreads, worth, wording.percent(varies.naive_error_rate)))
    return Table(head, tuple(rows))


def _positions(questions: Sequence[QuestionAnalysis]) -> Table:
    """Mean answers where ours was shown on each side, and the position bias."""
    rows = []
    for question in questions:
        if (at := question.position) is not None:
            as_a, as_b = map(_plus_minus, (at.mean_when_ours_is_a, at.mean_when_ours_is_b), at.half_widths)
            bias = f"{at.bias:+.2f} {bounds(at.interval)}".replace("-", "−")
            rows.append((question.title, as_a, as_b, bias, p_text(at.pvalue).removeprefix("= ")))
    return Table(("question", "ours as A", "ours as B", "position bias", "p"), tuple(rows))


def _gallery(question: QuestionAnalysis, study: Study, folder: Path) -> dict[str, Any]:
    """Every set by its mean, and those in which ours was judged best and worst, with their pictures."""
    items = {item.id: item for item in study.items}
    ranked = [(items[one.name], one) for one in sorted(question.by_item, key=lambda one: one.mean) if one.name in items]
    extremes = min(_NUM_EXTREMES, len(ranked) // 2)

    def shown(item: Item, mean: Mean, longest: int) -> dict[str, Any]:
        names = {"photograph": item.content, "style": (item.reference,) if item.reference else ()}
        names |= dict(zip(study.methods(item), (item.ours, item.theirs), strict=True))
        pictures = {name: _picture(folder, files, longest) for name, files in names.items() if files}
        return {"item": item, "mean": mean, "pictures": {name: data for name, data in pictures.items() if data}}

    return {
        "title": question.title,
        "best": [shown(*row, _LARGE) for row in ranked[:extremes]],
        "worst": [shown(*row, _LARGE) for row in ranked[len(ranked) - extremes :][::-1]],
        "all": [shown(*row, _SMALL) for row in ranked],
    }


def _plus_minus(mean: float, half_width: float) -> str:
    text = f"{mean:+.2f}".replace("-", "−")
    return text + (f" ± {half_width:.2f}" if math.isfinite(half_width) else "")


def _picture(folder: Path, files: tuple[str, ...], longest: int) -> str:
    """The middle view (of a video, its poster) as a small data URL; empty if the file is missing."""
    file = (folder / PICTURES / files[len(files) // 2]).with_suffix(".jpg")
    if not file.is_file():
        return ""
    with Image.open(file) as picture:
        small = picture.convert("RGB")
    small.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    return data_url(small, "jpeg", quality=82)
