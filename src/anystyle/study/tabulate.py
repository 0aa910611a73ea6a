"""The findings as tables for papers: Markdown and LaTeX."""

import math
from collections.abc import Callable, Sequence

from anystyle.study.analysis import Analysis, NamedResult, QuestionAnalysis

_SPECIAL_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{character: "\\" + character for character in "&%$#_{}"},
}


def p_text(pvalue: float, log10_pvalue: float | None = None) -> str:
    """A p-value with its relation sign, as one writes it: ``= 0.013``, ``= 3.5e-40``, ``< 1e-300``."""
    if math.isnan(pvalue):
        return "n/a"
    if pvalue < 1e-300:
        return "< 1e-300" if log10_pvalue is None else f"= 1e{log10_pvalue:.0f}"
    if pvalue < 1e-4:
        return f"= {pvalue:.2e}"
    if pvalue < 1e-3:
        return f"= {pvalue:.4f}"
    return f"= {pvalue:.3f}" if pvalue < 0.9995 else "= 1.000"


def plain_p(named: NamedResult) -> str:
    """A result's p-value without a relation sign, where a column's head says ``p``."""
    text = p_text(named.result.pvalue, named.result.log10_pvalue)
    return text.removeprefix("= ")


def generalizes(named: NamedResult) -> str:
    """For whom a result holds."""
    return "new " + " and ".join(named.result.generalizes_to) if named.result.generalizes_to else "no one else"


def title_of(name: str) -> str:
    """A test's name for people."""
    return name.replace("_", " ")


def effect_title(name: str) -> str:
    """An effect's name for people."""
    return {"cohens_d": "Cohen's d", "rank_biserial": "rank-biserial"}.get(name, name.replace("_", " "))


def escape_tex(text: str) -> str:
    """Text that LaTeX sets as it stands."""
    return "".join(_SPECIAL_TEX.get(character, character) for character in text)


def escape_markdown(text: str) -> str:
    """Text that Markdown shows as it stands, in a cell of a table."""
    plain = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return " ".join("".join("\\" + letter if letter in "\\`*_[]|#" else letter for letter in plain).split())


def _interval(bounds: tuple[float, float]) -> str:
    return "" if math.isnan(bounds[0]) else f"[{bounds[0]:.2f}, {bounds[1]:.2f}]"


def _rows(question: QuestionAnalysis, escape: Callable[[str], str]) -> list[list[str]]:
    rows = []
    for named in question.tests:
        result = named.result
        effect = f"{result.effect:.2f} {_interval(result.effect_interval)}".strip() if result.effect_name else ""
        rows.append(
            [
                escape(title_of(named.name)),
                result.unit,
                str(result.n),
                f"{result.estimate:.3f}" + (" " + escape(result.estimate_unit)) * (result.estimate_unit != "points"),
                _interval(result.interval),
                f"{result.statistic:.2f}" if math.isfinite(result.statistic) else "",
                plain_p(named),
                "n/a" if math.isnan(named.log_pvalue_holm) else p_text(math.exp(named.log_pvalue_holm)).lstrip("= "),
                effect,
                generalizes(named),
            ]
        )
    return rows


_HEAD = ("test", "unit", "n", "estimate", "95 % interval", "statistic", "p", "p (Holm)", "effect", "holds for")


def _head(analysis: Analysis) -> Sequence[str]:
    return [word.replace("95", f"{100 * analysis.settings.confidence:g}") for word in _HEAD]


def markdown(analysis: Analysis) -> str:
    """Every test of every question."""
    lines = ["Negative estimates prefer ours. Response-level p-values count answers of one person as independent.", ""]
    for question in analysis.questions:
        mean = question.responses.deviations.mean() + question.responses.scale.midpoint
        lines += [f"### {escape_markdown(question.title)}", ""]
        lines += [
            f"{question.responses.count} answers of {len(question.by_participant.names)} participants to "
            f"{len(question.by_item.names)} items; mean {mean:.3f}; counts "
            + ", ".join(f"{level:g}: {count}" for level, count in zip(question.levels, question.counts, strict=True)),
            "",
            "| " + " | ".join(_head(analysis)) + " |",
            "|" + "|".join("---" if column in (0, 1, 8, 9) else "---:" for column in range(len(_HEAD))) + "|",
        ]
        lines += ["| " + " | ".join(row) + " |" for row in _rows(question, escape_markdown)]
        lines.append("")
    return "\n".join(lines)


def latex(analysis: Analysis) -> str:
    """The same as ``booktabs`` tables."""
    lines = ["% needs \\usepackage{booktabs}; negative estimates prefer ours"]
    for question in analysis.questions:
        head = " & ".join(escape_tex(word) for word in _head(analysis))
        lines += ["\\begin{tabular}{llrrrrrrll}", "\\toprule"]
        lines += [f"\\multicolumn{{{len(_HEAD)}}}{{l}}{{{escape_tex(question.title)}}} \\\\", "\\midrule"]
        lines += [f"{head} \\\\", "\\midrule"]
        lines += [" & ".join(_tex_numbers(row)) + " \\\\" for row in _rows(question, escape_tex)]
        lines += ["\\bottomrule", "\\end{tabular}", ""]
    return "\n".join(lines)


def _tex_numbers(row: list[str]) -> list[str]:
    """Powers of ten and minus signs as LaTeX writes them."""
    return [_tex_number(cell) if index in (3, 5, 6, 7) else cell for index, cell in enumerate(row)]


def _tex_number(cell: str) -> str:
    mantissa, exponent, power = cell.partition("e")
    if exponent and mantissa[:1].isdigit():
        return f"${mantissa} \\times 10^{{{int(power)}}}$"
    number, space, unit = cell.partition(" ")
    return f"${number}${space}{unit}" if cell.startswith("-") else cell.replace("<", "$<$")
