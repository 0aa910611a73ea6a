"""Tables as Markdown, CSV and LaTeX; the one writer of tables for evaluations, reports and user studies."""

import csv
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate, groupby
from pathlib import Path

STAND_IN = "stand-in, not comparable"
"""The note on every figure that a stand-in network computed."""

_ARROWS = {"higher": "↑", "lower": "↓"}
_NUMERIC = re.compile(r"[\d\[<+\-−–—∞.]")
_MARKDOWN = re.compile(r"[\\`*|]|(?<![^\W_])_|_(?![^\W_])|\](?=[(\[:])|^#")
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$", "↑": r"$\uparrow$",
    "↓": r"$\downarrow$", "×": r"$\times$", "±": r"$\pm$", "−": "$-$", "∞": r"$\infty$", "†": r"$\dagger$",
    "‡": r"$\ddagger$", "–": "--", "—": "---", "“": "``", "”": "''", "✓": r"$\checkmark$", "✗": r"$\times$",
}  # fmt: skip
_MARKS = {"1st": "textbf", "2nd": "underline"}


@dataclass(frozen=True)
class Table:
    r"""Texts in rows and columns, with a caption above and notes below.

    Columns of numbers, intervals and dashes are aligned right, others left. Every form escapes the texts. Neighbours
    with the same first line (``scene\nfigure``) share it in LaTeX. An empty row is a rule, which LaTeX alone shows; a
    row of one text is the title of a block of rows, in CSV a column.

    Example:
        >>> print(Table(("method", "PSNR"), (("head", "23.7"), ("full", "24.1"))).markdown())
        | method | PSNR |
        |--------|-----:|
        | head   | 23.7 |
        | full   | 24.1 |
        <BLANKLINE>
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """As a table of GitHub's Markdown, with aligned columns."""
        cells = [[escape_markdown(text) for text in row] for row in (self.columns, *self.rows) if row]
        blank = [""] * (len(self.columns) - 1)
        cells = [[f"**{row[0]}**", *blank] if len(row) == 1 else row for row in cells]
        widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
        lines = [f"| {' | '.join(map(str.ljust, row, widths))} |" for row in cells]
        rules = ["-" * (width + 1) + "-:"[number] for width, number in zip(widths, self._numeric(), strict=True)]
        caption = [f"**{escape_markdown(self.caption)}**\n"] if self.caption else []
        notes = [f"\n{escape_markdown(note)}" for note in self.notes]
        return "\n".join([*caption, lines[0], f"|{'|'.join(rules)}|", *lines[1:], *notes]) + "\n"

    def csv(self) -> str:
        """As comma-separated values, without caption and notes."""
        text = io.StringIO()
        rows, block = [[escape_csv(column).replace("\n", " ") for column in self.columns]], ()
        for row in filter(None, self.rows):
            if len(row) == 1:
                rows, block = (rows if block else [["block", *rows[0]]]), row
            else:
                rows.append([*block, *row])
        csv.writer(text, lineterminator="\n").writerows(map(escape_csv, row) for row in rows)
        return text.getvalue()

    def latex(self) -> str:
        """As a floating table with its caption and notes; needs ``booktabs``."""
        caption = [rf"\caption{{{escape_latex(self.caption)}}}"] if self.caption else []
        notes = [rf"\par\smallskip\footnotesize {escape_latex(note)}" for note in self.notes]
        lines = [r"\begin{table}[t]", r"\centering", *caption, self.tabular(), *notes, r"\end{table}"]
        return "\n".join(lines) + "\n"

    def tabular(self) -> str:
        """The LaTeX ``tabular`` alone; needs ``booktabs``, and ``amssymb`` for ✓."""
        lines = [rf"\begin{{tabular}}{{{''.join('lr'[number] for number in self._numeric())}}}", r"\toprule"]
        spans = [(head, len([*group])) for head, group in groupby(text.rpartition("\n")[0] for text in self.columns)]
        if len(spans) > 1:
            ends = list(accumulate(width for _, width in spans))
            lines.append(" & ".join(rf"\multicolumn{{{n}}}{{c}}{{{escape_latex(head)}}}" for head, n in spans) + r" \\")
            ruled = [(end - n + 1, end) for (head, n), end in zip(spans, ends, strict=True) if head]
            lines.append(" ".join(rf"\cmidrule(lr){{{start}-{end}}}" for start, end in ruled))
        rule = [] if self.rows and len(self.rows[0]) == 1 else [()]
        for row in ([text.rpartition("\n")[2] for text in self.columns], *rule, *self.rows):
            text = " & ".join(map(escape_latex, row)) + r" \\"
            if len(row) == 1:
                span = rf"\multicolumn{{{len(self.columns)}}}{{c}}{{\textit{{{escape_latex(row[0])}}}}} \\"
                text = "\n".join([r"\midrule", span, r"\midrule"])
            lines.append(text if row else r"\midrule")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])

    def write(self, folder: Path, name: str) -> list[str]:
        """Write ``name.md``, ``name.csv`` and ``name.tex`` into a folder, and return these names."""
        texts = {f"{name}.md": self.markdown(), f"{name}.csv": self.csv(), f"{name}.tex": self.latex()}
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8", errors="backslashreplace")
        return list(texts)

    def _numeric(self) -> list[bool]:
        """For each column but the first whether all of its texts are numbers or empty."""
        columns = zip(self.columns, *(row for row in self.rows if len(row) > 1), strict=True)
        return [
            n > 0 and all(not text or _NUMERIC.match(text) for text in texts) for n, (_, *texts) in enumerate(columns)
        ]


def escape_markdown(text: str) -> str:
    """A text in one line that Markdown shows literally, also in a cell of a table."""
    text = _MARKDOWN.sub(r"\\\g<0>", " ".join(text.split()))
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def escape_latex(text: str) -> str:
    """A text that LaTeX shows literally; mathematics are ``2e-05`` and minus signs, ``1.5 (1st)`` is bold."""
    text = "".join(_LATEX.get(letter, letter) for letter in text)
    text = re.sub(r"^(\S+) \((1st|2nd)\)$", lambda mark: rf"\{_MARKS[mark[2]]}{{{mark[1]}}}", text)
    text = re.sub(r"\b(\d(?:\.\d+)?)e\+?(-?)0*(\d+)\b", r"$\1 \\times 10^{\2\3}$", text)
    return re.sub(r"(?<=[\s\[(])-(?=\d)|^-(?=\d)", "$-$", text)


def escape_csv(text: str) -> str:
    """A text that no spreadsheet takes for a formula: one that looks like it gets a leading apostrophe."""
    try:
        float(text)
    except ValueError:
        risky = text.startswith(("=", "+", "-", "@", "\t", "\r", "\n"))
        # The writer does not quote a carriage return, after which readers begin a new row.
        return ("'" * risky + text).replace("\r", " ")
    return text


def number(value: float | None) -> str:
    """A value in four significant digits; a dash for ``None`` and ``nan``.

    Example:
        >>> number(23.71049), number(0.0000215), number(None)
        ('23.71', '2.15e-05', '–')
    """
    if value is None or math.isnan(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
    return f"{value:.2e}"


def titled(name: str, better: Mapping[str, str]) -> str:
    """A figure's name with an arrow in its better direction (``higher`` or ``lower``)."""
    return f"{name} {_ARROWS[better[name]]}" if name in better else name
