"""Plots of evaluations: scores of every style, and the best and worst examples."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from anystyle.contracts.protocol import Evaluation, Row
from anystyle.data.images import open_image
from anystyle.errors import of_extra
from anystyle.evaluation.tables import STAND_IN, number, titled
from anystyle.io.atomic import atomic_path
from anystyle.io.sheet import Cell, contact_sheet

COLORS = {"ours": "#2f5d8a", "stand-in": "#c0862b", "published": "#8a8a92"}
INK, RULE = "#1c1c1e", "#dcdce2"


def spread(evaluation: Evaluation, path: Path, *, caption: str = "") -> None:
    """Draw a panel for each score: a dot for each scene in each style, a line at each scene's score in the table.

    The score of a scene is not the mean of its styles' where a metric judges all images together, as FID does. Where
    kinds of results have scores of their own in the table, as the fit and a single pass, there is a level for each kind
    in place of each scene.
    """
    names = [name for name in evaluation.scores if len(_values(evaluation.rows, name)) > 1]
    if not names:
        return
    levels: dict[str, list[Row]] = {}
    for row in evaluation.rows:
        kind = row.style.partition(", ")[0]
        levels.setdefault(kind if kind in evaluation.groups else row.scene, []).append(row)
    known = {**evaluation.groups, **evaluation.scenes, "": evaluation.scores}
    figure, axes = panels(len(names), list(levels), width=3.1, height=1.25 + 0.16 * len(levels), margin=(0.0, 0.4))
    explanation = ""
    for axis, name in zip(axes, names, strict=True):
        stands_in = name in evaluation.stand_ins
        color = COLORS["stand-in" if stands_in else "ours"]
        for level, (title, rows) in enumerate(levels.items()):
            values = _values([row for row in rows if ", " in row.style], name) or _values(rows, name)
            axis.plot(values, [level] * len(values), "o", color=color, alpha=0.45, markersize=5, markeredgewidth=0)
            score = known.get(title, {}).get(name, math.nan)
            if math.isfinite(score):
                axis.plot([score] * 2, [level - 0.22, level + 0.22], color=INK, linewidth=1.4)
                explanation = "dot: one scene in one style; line: the score of all, as in the table"
        axis.tick_params(axis="x", labelsize=7, color=RULE)
        axis.xaxis.get_offset_text().set_fontsize(7)
        axis.locator_params(axis="x", nbins=4)
        label(axis, titled(name, evaluation.better), stands_in)
    write_caption(figure, caption, explanation)
    save(figure, path)


def examples(evaluation: Evaluation, path: Path) -> None:
    """Lay out the best and the worst rows of the first score that has a better direction."""
    rows = [row for row in evaluation.rows if row.pictures]
    first = next((name for name in evaluation.better if len(_values(rows, name)) == len(rows) > 1), None)
    if first is None:
        return
    better = evaluation.better[first]
    rows.sort(key=lambda row: row.scores[first], reverse=better == "higher")
    half = min(4, len(rows) // 2)
    chosen = [("best", row) for row in rows[:half]] + [("worst", row) for row in rows[-half:]]
    kinds = ("photograph", "style", "result")
    titles = [f"{rank}: {number(row.scores[first])} {row.scene} {row.style}".strip() for rank, row in chosen]
    cells: list[list[Cell]] = [
        [open_image(row.pictures[kind], longest=640) if kind in row.pictures else None for _, row in chosen]
        for kind in kinds
    ]
    note = f"by {first}, {better} is better" + (f" ({STAND_IN})" if first in evaluation.stand_ins else "")
    with atomic_path(path) as temporary:
        contact_sheet(cells, column_titles=titles, row_titles=kinds, footer=note, cell=(160, 160)).save(temporary)


def panels(
    num_panels: int, titles: Sequence[str], *, width: float, height: float, margin: tuple[float, float]
) -> tuple[Any, list[Any]]:
    """A figure with panels in rows of four, and their axes; each has a level for every title, from above."""
    num_columns = min(4, num_panels)
    num_rows = math.ceil(num_panels / num_columns)
    size = margin[0] + num_columns * width, margin[1] + num_rows * height
    figure = of_extra("matplotlib.figure", "plots need", "report").Figure(figsize=size, dpi=130)
    axes = list(figure.subplots(num_rows, num_columns, squeeze=False).flat)
    for index, axis in enumerate(axes[:num_panels]):
        labels = titles if index % num_columns == 0 else ()
        axis.set_yticks(range(len(labels)), labels, fontsize=7)
        axis.set_ylim(len(titles) - 0.5, -0.5)
        axis.tick_params(axis="y", length=0)
        axis.spines[["top", "right", "left"]].set_visible(False)
        axis.spines["bottom"].set_color(RULE)
    for axis in axes[num_panels:]:
        axis.axis("off")
    return figure, axes[:num_panels]


def write_caption(figure: Any, *texts: str) -> None:
    """Write lines below all panels of a figure; empty ones are left out."""
    figure.supxlabel("\n".join(filter(None, texts)), fontsize=7, color="#6e6e76")


def label(axis: Any, title: str, stands_in: bool) -> None:
    """Write a panel's title, and below it whether its scores are of a stand-in."""
    axis.set_title(title, fontsize=8.5, color=INK, loc="left")
    if stands_in:
        axis.set_xlabel(STAND_IN, fontsize=7, color=COLORS["stand-in"])


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG."""
    figure.set_layout_engine("constrained")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})  # no version: the bytes are reproducible


def _values(rows: Sequence[Row], name: str) -> list[float]:
    return [value for row in rows if math.isfinite(value := row.scores.get(name, math.nan))]
