"""Pictures of an evaluation: how figures spread over styles, and the best and worst examples."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from anystyle.data.images import open_image
from anystyle.evaluation.contract import Evaluation, Row
from anystyle.evaluation.tables import STAND_IN, number, titled
from anystyle.io.atomic import atomic_path
from anystyle.io.sheet import Cell, contact_sheet

OURS, STOOD_IN, PUBLISHED = "#2f5d8a", "#c0862b", "#8a8a92"
"""Colours of figures computed with published weights or none, with stand-ins, and of published figures."""

_INK, _RULE = "#1c1c1e", "#dcdce2"
_NUM_EXAMPLES = 4


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


def spread(evaluation: Evaluation, path: Path, *, caption: str = "") -> bool:
    """Draw a panel for each figure, in it a dot for each scene in each style and a line at each scene's mean.

    Returns:
        Whether there was anything to draw.

    Raises:
        ImportError: matplotlib is not installed.
    """
    names = [name for name in evaluation.figures if len(_values(evaluation.rows, name)) > 1]
    if not names:
        return False
    scenes = list(dict.fromkeys(row.scene for row in evaluation.rows))
    figure, axes = _panels(len(names), scenes, width=3.1, height=1.25 + 0.16 * len(scenes), margin=(0.0, 0.4))
    for axis, name in zip(axes, names, strict=True):
        color = STOOD_IN if name in evaluation.stand_ins else OURS
        for level, scene in enumerate(scenes):
            values = _values([row for row in evaluation.rows if row.scene == scene], name)
            axis.plot(values, [level] * len(values), "o", color=color, alpha=0.45, markersize=5, markeredgewidth=0)
            if values:
                mean = sum(values) / len(values)
                axis.plot([mean, mean], [level - 0.22, level + 0.22], color=_INK, linewidth=1.4)
        axis.tick_params(axis="x", labelsize=7, color=_RULE)
        axis.xaxis.get_offset_text().set_fontsize(7)
        axis.locator_params(axis="x", nbins=4)
        _label(axis, titled(name, evaluation.better), STAND_IN if name in evaluation.stand_ins else "")
    figure.supxlabel(caption, fontsize=7, color="#6e6e76") if caption else None
    save(figure, path)
    return True


def examples(evaluation: Evaluation, path: Path) -> bool:
    """Lay out the best and the worst rows of the first figure that has a better direction.

    Returns:
        Whether there were pictures to show.
    """
    rows = [row for row in evaluation.rows if row.pictures]
    figure = next((name for name in evaluation.better if len(_values(rows, name)) == len(rows) > 1), None)
    if figure is None:
        return False
    better = evaluation.better[figure]
    rows.sort(key=lambda row: row.figures[figure], reverse=better == "higher")
    number_each = min(_NUM_EXAMPLES, len(rows) // 2)
    chosen = [("best", row) for row in rows[:number_each]] + [("worst", row) for row in rows[-number_each:]]
    kinds = ("photograph", "style", "result")
    titles = [f"{rank}: {number(row.figures[figure])} {row.scene} {row.style}".strip() for rank, row in chosen]
    cells: list[list[Cell]] = [[_picture(row, kind) for _, row in chosen] for kind in kinds]
    note = f"by {figure}, {better} is better" + (f" ({STAND_IN})" if figure in evaluation.stand_ins else "")
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
    """Draw a panel for each figure, in it a bar for each row of a table, and a figure's note below it.

    Raises:
        ImportError: matplotlib is not installed.
    """
    titles = list(groups)
    figure, axes = _panels(len(names), titles, width=2.3, height=0.75 + 0.24 * len(titles), margin=(1.6, 0.1))
    for axis, name in zip(axes, names, strict=True):
        values = [groups[title].get(name, math.nan) for title in titles]
        axis.barh(range(len(titles)), values, color=[colors.get((title, name), OURS) for title in titles], height=0.66)
        for level, value in enumerate(values):
            text = "–" if math.isnan(value) else number(value)
            axis.text(0 if math.isnan(value) else value, level, f" {text}", va="center", fontsize=6.5, color=_INK)
        known = [value for value in values if not math.isnan(value)]
        if known:
            axis.set_xlim(1.3 * min(0, *known), 1.3 * max(0, *known, 1e-9))
        axis.set_xticks([])
        _label(axis, titled(name, better), notes.get(name, ""))
    save(figure, path)


def _panels(
    num_panels: int, titles: Sequence[str], *, width: float, height: float, margin: tuple[float, float]
) -> tuple[Any, list[Any]]:
    """A figure with panels in rows of four, and their axes; each has a level for every title, from above."""
    num_columns = min(4, num_panels)
    num_rows = math.ceil(num_panels / num_columns)
    figure = plotting()(figsize=(margin[0] + num_columns * width, margin[1] + num_rows * height), dpi=130)
    axes = list(figure.subplots(num_rows, num_columns, squeeze=False).flat)
    for index, axis in enumerate(axes[:num_panels]):
        labels = titles if index % num_columns == 0 else ()
        axis.set_yticks(range(len(labels)), labels, fontsize=7)
        axis.set_ylim(len(titles) - 0.5, -0.5)
        axis.tick_params(axis="y", length=0)
        for side in ("top", "right", "left"):
            axis.spines[side].set_visible(False)
        axis.spines["bottom"].set_color(_RULE)
    for axis in axes[num_panels:]:
        axis.axis("off")
    return figure, axes[:num_panels]


def _label(axis: Any, title: str, note: str) -> None:
    axis.set_title(title, fontsize=8.5, color=_INK, loc="left")
    if note:
        axis.set_xlabel(note, fontsize=7, color=STOOD_IN)


def save(figure: Any, path: Path) -> None:
    """Write a figure; the same one gives the same bytes."""
    figure.set_layout_engine("constrained")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _values(rows: Sequence[Row], name: str) -> list[float]:
    values = [row.figures.get(name, math.nan) for row in rows]
    return [value for value in values if math.isfinite(value)]


def _picture(row: Row, kind: str) -> Image.Image | None:
    return open_image(row.pictures[kind], longest=640) if kind in row.pictures else None
