"""The findings as a results section for a paper, in Markdown and in LaTeX."""

import math
import re

from anystyle.study.analysis import Analysis, QuestionAnalysis
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
from anystyle.study.verdicts import paragraph, registered, response_level, took_part

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
