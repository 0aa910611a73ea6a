"""A plot of runs: bars of every variant and of published methods."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from anystyle.evaluation import plots
from anystyle.evaluation.tables import number, titled
from anystyle_paper.run_table import ColumnKey, Line


def draw(lines: Sequence[Line], columns: Sequence[ColumnKey], better: Mapping[str, str], path: Path) -> bool:
    """Draw a panel for each score, in it a bar for each variant or published method; ``False`` without any score.

    Several seeds are dots, with the 95 % interval of their mean.
    """
    # Scores of stand-ins are marked below their panels, and have no bars of their own.
    titles: dict[str, None] = {}
    shown: dict[ColumnKey, dict[str, Line]] = {}
    for line in lines:
        title = f"{line.title}\npublished" if line.origin == "published" else line.title
        if line.state:
            title += f"\n{line.state}"
        titles[title] = None
        for column in columns:
            if math.isfinite(line.value(*column)):
                shown.setdefault(column, {})[title] = line
    if not shown:
        return False
    figure, axes = plots.panels(
        len(shown), list(titles), width=2.3, height=0.75 + 0.24 * len(titles), margin=(1.6, 0.1)
    )
    for axis, column in zip(axes, (column for column in columns if column in shown), strict=True):
        ends = [0.0, 1e-9]
        for level, title in enumerate(titles):
            if line := shown[column].get(title):
                ends += _bar(axis, level, line, column)
            else:
                axis.text(0, level, f" {number(None)}", va="center", fontsize=6.5, color=plots.INK)
        axis.set_xlim(1.3 * min(ends), 1.3 * max(ends))
        axis.set_xticks([])
        scene, name = column
        stands_in = any(line.origin == "stand-in" for line in shown[column].values())
        plots.label(axis, f"{scene} {titled(name, better)}".strip(), stands_in)
    if any(len(line.values(column)) > 1 for column, rows in shown.items() for line in rows.values()):
        plots.write_caption(figure, "dot: one seed; bar: their mean, with its 95 % t interval")
    plots.save(figure, path)
    return True


def _bar(axis: Any, level: int, line: Line, column: ColumnKey) -> list[float]:
    """Draw a value, its seeds and its interval if there are several; return all ends."""
    value, seeds = line.value(*column), line.values(column)
    axis.barh(level, value, color=plots.COLORS[line.origin], height=0.66)
    ends = [value]
    if len(seeds) > 1:
        error = line.half_width(column)
        axis.errorbar(value, level, xerr=error, color=plots.INK, linewidth=0.9, capsize=2.5)
        axis.plot(seeds, [level] * len(seeds), "o", color="white", markersize=3, mec=plots.INK, mew=0.6)
        ends += [value - error, value + error, *seeds]
    axis.text(max(0, *ends), level, f"  {number(value)}", va="center", fontsize=6.5, color=plots.INK)
    return ends
