"""Tables as Markdown, CSV and LaTeX."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

STAND_IN = "stand-in, not comparable"
"""The note on every figure that a stand-in network computed."""

_ARROWS = {"higher": "↑", "lower": "↓"}
_DIGITS = "0123456789-+.–"
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$", "×": r"$\times$",
    "–": "--", "±": r"$\pm$", "†": r"$\dagger$", "‡": r"$\ddagger$",
    "“": "``", "”": "''",
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """Texts in rows and columns, with a caption above and notes below."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """As a table of GitHub's Markdown, with aligned columns."""
        cells = [[_md(text) for text in row] for row in (self.columns, *self.rows)]
        widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
        rows = [" | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) for row in cells]
        lines = [f"| {row} |" for row in rows]
        ends = [":" if number else "-" for number in self._numbers()]
        rule = "|".join("-" * (width + 1) + end for width, end in zip(widths, ends, strict=True))
        parts = [f"**{_md(self.caption)}**\n"] if self.caption else []
        parts.append("\n".join([lines[0], f"|{rule}|", *lines[1:]]))
        parts += [f"\n{_md(note)}" for note in self.notes]
        return "\n".join(parts) + "\n"

    def csv(self) -> str:
        """As comma-separated values, without caption and notes."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([[_cell(text) for text in row] for row in (self.columns, *self.rows)])
        return text.getvalue()

    def latex(self) -> str:
        """As a ``tabular`` with booktabs' rules."""
        body = [" & ".join(map(tex, row)) + r" \\" for row in self.rows]
        lines = [
            r"\begin{table}[t]",
            r"\centering",
            *([rf"\caption{{{tex(self.caption)}}}"] if self.caption else []),
            rf"\begin{{tabular}}{{{''.join('r' if number else 'l' for number in self._numbers())}}}",
            r"\toprule",
            " & ".join(map(tex, self.columns)) + r" \\",
            r"\midrule",
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            *(rf"\par\smallskip\footnotesize {tex(note)}" for note in self.notes),
            r"\end{table}",
        ]
        return "\n".join(lines) + "\n"

    def _numbers(self) -> list[bool]:
        """For each column whether it holds numbers, which are aligned right; the first does not."""
        columns = list(zip(*self.rows, strict=True)) if self.rows else [()] * len(self.columns)
        return [index > 0 and all(not text or text[0] in _DIGITS for text in c) for index, c in enumerate(columns)]


def tex(text: str) -> str:
    """A text with LaTeX's special characters escaped."""
    return "".join(_LATEX.get(letter, letter) for letter in text)


def number(value: float | None) -> str:
    """A value in four significant digits; a dash for none."""
    if value is None or math.isnan(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
    return f"{value:.2e}"


def titled(name: str, better: Mapping[str, str]) -> str:
    """A figure's name with an arrow in its better direction."""
    return f"{name} {_ARROWS[better[name]]}" if name in better else name


def figures_table(
    columns: Mapping[str, Mapping[str, float]],
    better: Mapping[str, str],
    stand_ins: Mapping[str, str],
    *,
    caption: str = "",
    notes: Sequence[str] = (),
) -> Table:
    """A row for each figure, a column for each group of figures by its title; figures of stand-ins have a note."""
    names = list(dict.fromkeys(name for figures in columns.values() for name in figures))
    remarks = [f"{STAND_IN} ({stand_ins[name]})" if name in stand_ins else "" for name in names]
    rows = [
        (titled(name, better), *(number(figures.get(name)) for figures in columns.values()), remark)
        for name, remark in zip(names, remarks, strict=True)
    ]
    titles = ("figure", *columns, "note")
    if not any(remarks):
        titles, rows = titles[:-1], [row[:-1] for row in rows]
    return Table(titles, tuple(rows), caption, tuple(notes))


def _md(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")


def _cell(text: str) -> str:
    """A cell that no spreadsheet takes for a formula: a text that looks like one has an apostrophe before it.

    A carriage return is a space: the writer leaves it bare, and readers begin a row, and maybe a formula, after it.
    """
    try:
        float(text)
    except ValueError:
        risky = text.startswith(("=", "+", "-", "@", "\t", "\r", "\n"))
        return ("'" * risky + text).replace("\r", " ")
    return text
