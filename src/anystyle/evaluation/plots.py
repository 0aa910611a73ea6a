"""Pictures of an evaluation: how figures spread over styles, and the best and worst examples."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from anystyle.data.images import open_image
from anystyle.evaluation.contract import Evaluation, Row
from anystyle.evaluation.tables import STAND_IN, number, titled
from anystyle.files import atomic_path
from anystyle.sheet import Cell, contact_sheet

OURS, STOOD_IN, PUBLISHED = "#2f5d8a", "#c0862b", "#8a8a92"
"""Colours of what was computed with the weights that are named, with stand-ins, and of what others published."""

_INK, _RULE = "#1c1c1e", "#dcdce2"
_EXAMPLES = 4


def plotting() -> Any:
    """Matplotlib's figures, drawn without a screen.

    Raises:
        ImportError: It is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        raise ImportError('plots need matplotlib: pip install "anystyle[report]"') from None
    return Figure


def spread(found: Evaluation, path: Path, *, caption: str = "") -> bool:
    """Draw, for each figure, a dot for each scene in each style, and a line at their mean.

    Args:
        found: What a protocol returned.
        path: A PNG.
        caption: A line under all.

    Returns:
        Whether there was anything to draw.

    Raises:
        ImportError: matplotlib is not installed.
    """
    names = [name for name in found.figures if len(_values(found.rows, name)) > 1]
    if not names:
        return False
    columns = min(4, len(names))
    lines = math.ceil(len(names) / columns)
    scenes = list(dict.fromkeys(row.scene for row in found.rows))
    height = 0.9 + 0.16 * len(scenes)
    figure = plotting()(figsize=(3.1 * columns, lines * (height + 0.35) + 0.4), dpi=130)
    axes = figure.subplots(lines, columns, squeeze=False)
    for place, name in enumerate(names):
        axis = axes[place // columns][place % columns]
        color = STOOD_IN if name in found.stand_ins else OURS
        for level, scene in enumerate(scenes):
            values = _values([row for row in found.rows if row.scene == scene], name)
            axis.plot(values, [level] * len(values), "o", color=color, alpha=0.45, markersize=5, markeredgewidth=0)
            if values:
                middle = sum(values) / len(values)
                axis.plot([middle, middle], [level - 0.22, level + 0.22], color=_INK, linewidth=1.4)
        axis.set_yticks(range(len(scenes)), scenes if place % columns == 0 else [""] * len(scenes), fontsize=7)
        axis.set_ylim(len(scenes) - 0.5, -0.5)
        axis.tick_params(axis="x", labelsize=7, color=_RULE)
        axis.xaxis.get_offset_text().set_fontsize(7)
        axis.tick_params(axis="y", length=0)
        axis.locator_params(axis="x", nbins=4)
        axis.set_title(titled(name, found.better), fontsize=8.5, color=_INK, loc="left")
        if name in found.stand_ins:
            axis.set_xlabel(STAND_IN, fontsize=7, color=STOOD_IN)
        plain(axis)
    for place in range(len(names), lines * columns):
        axes[place // columns][place % columns].axis("off")
    figure.supxlabel(caption, fontsize=7, color="#6e6e76") if caption else None
    save(figure, path)
    return True


def examples(found: Evaluation, path: Path) -> bool:
    """Lay out the best and the worst rows of the first figure that says which is better.

    Args:
        found: What a protocol returned.
        path: A PNG.

    Returns:
        Whether there were pictures to show.
    """
    shown = [row for row in found.rows if row.pictures]
    ranked = next((name for name in found.better if len(_values(shown, name)) == len(shown) > 1), None)
    if ranked is None:
        return False
    order = sorted(shown, key=lambda row: row.figures[ranked], reverse=found.better[ranked] == "higher")
    count = min(_EXAMPLES, len(order) // 2)
    chosen = [("best", row) for row in order[:count]] + [("worst", row) for row in order[-count:]]
    kinds = ("photograph", "style", "result")
    titles = [f"{rank}: {number(row.figures[ranked])} {row.scene} {row.style}".strip() for rank, row in chosen]
    cells: list[list[Cell]] = [[_picture(row, kind) for _, row in chosen] for kind in kinds]
    note = f"by {ranked}, {found.better[ranked]} is better" + (f" ({STAND_IN})" if ranked in found.stand_ins else "")
    sheet = contact_sheet(cells, column_titles=titles, row_titles=kinds, footer=note, cell=(160, 160))
    with atomic_path(path) as temporary:
        sheet.save(temporary)
    return True


def bars(
    groups: Mapping[str, Mapping[str, float]],
    names: Sequence[str],
    path: Path,
    *,
    better: Mapping[str, str],
    colors: Mapping[tuple[str, str], str],
    notes: Mapping[str, str],
) -> None:
    """Draw a panel for each figure, in it a bar for each row of a table.

    Args:
        groups: Figures of each row, by its title.
        names: Which figures.
        path: A PNG.
        better: ``higher`` or ``lower`` by figure.
        colors: Of each bar, by row and figure.
        notes: Written below a panel, by figure.

    Raises:
        ImportError: matplotlib is not installed.
    """
    columns = min(4, len(names))
    lines = math.ceil(len(names) / columns)
    figure = plotting()(figsize=(1.6 + 2.3 * columns, lines * (0.75 + 0.24 * len(groups)) + 0.1), dpi=130)
    axes = figure.subplots(lines, columns, squeeze=False)
    for place, name in enumerate(names):
        axis = axes[place // columns][place % columns]
        values = [groups[title].get(name, math.nan) for title in groups]
        axis.barh(range(len(groups)), values, color=[colors.get((title, name), OURS) for title in groups], height=0.66)
        known = [value for value in values if not math.isnan(value)]
        for level, value in enumerate(values):
            text = "–" if math.isnan(value) else number(value)
            axis.text(0 if math.isnan(value) else value, level, f" {text}", va="center", fontsize=6.5, color=_INK)
        if known:
            axis.set_xlim(
                min(0, *known) * 1.3 if len(known) > 1 else min(0, known[0]) * 1.3, max(0, *known, 1e-9) * 1.3
            )
        axis.set_yticks(range(len(groups)), list(groups) if place % columns == 0 else [""] * len(groups), fontsize=7.5)
        axis.set_ylim(len(groups) - 0.5, -0.5)
        axis.set_xticks([])
        axis.tick_params(axis="y", length=0)
        axis.set_title(titled(name, better), fontsize=8.5, color=_INK, loc="left")
        if name in notes:
            axis.set_xlabel(notes[name], fontsize=7, color=STOOD_IN)
        plain(axis)
    for place in range(len(names), lines * columns):
        axes[place // columns][place % columns].axis("off")
    save(figure, path)


def plain(axis: Any) -> None:
    """Leave out what carries nothing."""
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.spines["bottom"].set_color(_RULE)


def save(figure: Any, path: Path) -> None:
    """Write a figure; the same one gives the same bytes."""
    figure.set_layout_engine("constrained")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _values(rows: Sequence[Row], name: str) -> list[float]:
    values = [row.figures.get(name, math.nan) for row in rows]
    return [value for value in values if not math.isnan(value)]


def _picture(row: Row, kind: str) -> Image.Image | None:
    return open_image(row.pictures[kind], longest=640) if kind in row.pictures else None
