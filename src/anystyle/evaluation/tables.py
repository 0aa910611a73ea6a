"""Tables as Markdown, CSV and LaTeX."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

STAND_IN = "stand-in, not comparable"
"""What every table says of a figure that a stand-in network computed."""

_ARROWS = {"higher": "↑", "lower": "↓"}
_FIGURES = "0123456789-+.–"
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$", "×": r"$\times$",
    "–": "--", "±": r"$\pm$", "†": r"$\dagger$", "‡": r"$\ddagger$",
    "“": "``", "”": "''",
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """Words in rows and columns.

    Args:
        columns: Titles.
        rows: As many words each.
        caption: What it shows, in a line.
        notes: Lines below it.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """As a table of GitHub's Markdown, the columns aligned for those who read it as text."""
        cells = [[_md(word) for word in row] for row in (self.columns, *self.rows)]
        widths = [max(3, *(len(row[place]) for row in cells)) for place in range(len(self.columns))]
        lines = [
            "| " + " | ".join(word.ljust(width) for word, width in zip(row, widths, strict=True)) + " |"
            for row in cells
        ]
        rule = (
            "|"
            + "|".join(
                "-" * (width + 1) + ":" if number else "-" * (width + 2)
                for width, number in zip(widths, self._numbers(), strict=True)
            )
            + "|"
        )
        parts = [f"**{_md(self.caption)}**\n"] if self.caption else []
        parts.append("\n".join([lines[0], rule, *lines[1:]]))
        parts += [f"\n{_md(note)}" for note in self.notes]
        return "\n".join(parts) + "\n"

    def csv(self) -> str:
        """As comma-separated values; notes are left to the other forms."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([self.columns, *self.rows])
        return text.getvalue()

    def latex(self) -> str:
        """As a ``tabular`` in booktabs' manner."""
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
        """Of each column but the first, whether it holds figures, which stand at the right; words stand at the left."""
        columns = zip(*self.rows, strict=True) if self.rows else [()] * len(self.columns)
        return [place > 0 and all(not word or word[0] in _FIGURES for word in c) for place, c in enumerate(columns)]


def tex(text: str) -> str:
    """A text with what LaTeX would take for commands escaped."""
    return "".join(_LATEX.get(letter, letter) for letter in text)


def number(value: float | None) -> str:
    """A figure in four digits; a dash where there is none."""
    if value is None or math.isnan(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
    return f"{value:.2e}"


def titled(name: str, better: Mapping[str, str]) -> str:
    """A figure's name with an arrow to where it is better."""
    return f"{name} {_ARROWS[better[name]]}" if name in better else name


def figures_table(
    columns: Mapping[str, Mapping[str, float]],
    better: Mapping[str, str],
    stand_ins: Mapping[str, str],
    *,
    caption: str = "",
    notes: Sequence[str] = (),
) -> Table:
    """A row for each figure, a column for each group of figures; stand-ins are called so in their own rows.

    Args:
        columns: Figures by name, by title of the column.
        better: ``higher`` or ``lower`` by figure.
        stand_ins: Stand-in networks by figure.
        caption: Of the table.
        notes: Lines below.
    """
    names = list(dict.fromkeys(name for figures in columns.values() for name in figures))
    note = [f"{STAND_IN} ({stand_ins[name]})" if name in stand_ins else "" for name in names]
    rows = [
        (
            titled(name, better),
            *(number(figures.get(name)) for figures in columns.values()),
            *([said] if any(note) else []),
        )
        for name, said in zip(names, note, strict=True)
    ]
    titles = ("figure", *columns, *(["note"] if any(note) else []))
    return Table(titles, tuple(rows), caption, tuple(notes))


def _md(text: str) -> str:
    return text.replace("|", r"\|").replace("\n", " ")
