"""Tables as Markdown, CSV and LaTeX; the one writer of tables for evaluations, reports and user studies."""

import csv
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

STAND_IN = "stand-in, not comparable"
"""The note on every score that a stand-in network computed."""

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
    """Texts in rows and columns, with a caption above and notes below.

    Columns of numbers, intervals and dashes are aligned right, others left. Every form escapes the texts.

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
        cells = [[escape_markdown(text) for text in row] for row in (self.columns, *self.rows)]
        widths = [max(3, *map(len, column)) for column in zip(*cells, strict=True)]
        lines = [f"| {' | '.join(map(str.ljust, row, widths))} |" for row in cells]
        ends = (":" if numeric else "-" for numeric in self._numeric())
        rules = ["-" * (width + 1) + end for width, end in zip(widths, ends, strict=True)]
        caption = [f"**{escape_markdown(self.caption)}**\n"] if self.caption else []
        notes = [f"\n{escape_markdown(note)}" for note in self.notes]
        return "\n".join([*caption, lines[0], f"|{'|'.join(rules)}|", *lines[1:], *notes]) + "\n"

    def csv(self) -> str:
        """As comma-separated values, without caption and notes."""
        text = io.StringIO()
        rows = ([escape_csv(cell) for cell in row] for row in (self.columns, *self.rows))
        csv.writer(text, lineterminator="\n").writerows(rows)
        return text.getvalue()

    def latex(self) -> str:
        """As a floating table with its caption and notes; needs ``booktabs``."""
        caption = [rf"\caption{{{escape_latex(self.caption)}}}"] if self.caption else []
        notes = [rf"\par\smallskip\footnotesize {escape_latex(note)}" for note in self.notes]
        lines = [r"\begin{table}[t]", r"\centering", *caption, self.tabular(), *notes, r"\end{table}"]
        return "\n".join(lines) + "\n"

    def tabular(self) -> str:
        """The LaTeX ``tabular`` alone; needs ``booktabs``, and ``amssymb`` for ✓."""
        head, *rows = (" & ".join(map(escape_latex, row)) + r" \\" for row in (self.columns, *self.rows))
        aligned = "".join("r" if numeric else "l" for numeric in self._numeric())
        begin, end = rf"\begin{{tabular}}{{{aligned}}}", r"\end{tabular}"
        return "\n".join([begin, r"\toprule", head, r"\midrule", *rows, r"\bottomrule", end])

    def write(self, folder: Path, name: str) -> list[str]:
        """Write ``name.md``, ``name.csv`` and ``name.tex`` into a folder, and return these names."""
        texts = {f"{name}.md": self.markdown(), f"{name}.csv": self.csv(), f"{name}.tex": self.latex()}
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8", errors="backslashreplace")
        return list(texts)

    def _numeric(self) -> list[bool]:
        """For each column but the first whether all of its texts are numbers or empty."""
        columns = zip(self.columns, *self.rows, strict=True)
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
        if text.startswith(("=", "+", "-", "@", "\t", "\r", "\n")):
            text = f"'{text}"
        return text.replace("\r", " ")  # the writer does not quote it, and readers begin a new row after it
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
    """A score's name with an arrow in its better direction (``higher`` or ``lower``)."""
    return f"{name} {_ARROWS[better[name]]}" if name in better else name
