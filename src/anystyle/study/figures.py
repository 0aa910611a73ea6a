"""The study's figures: answers, means, positions, power. Deviations to the left of 0 prefer ours."""

import io
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from anystyle.study.analysis import Analysis, Means, QuestionAnalysis
from anystyle.study.contract import Unit
from anystyle.study.power import PowerStudy, Rate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OURS, NEUTRAL, THEIRS = "#1f6f8b", "#dcdcd8", "#c8642b"
INK, SOFT = "#24292e", "#6b7280"
_NAMED_ROWS = 45  # above, names would overlap
_STYLE = Path(__file__).parent / "pages" / "figures.mplstyle"


def require() -> None:
    """Make sure that figures can be drawn.

    Raises:
        ImportError: matplotlib is not installed.
    """
    try:
        import matplotlib as _  # noqa: F401
    except ImportError:
        raise ImportError('figures and the report need matplotlib: pip install "anystyle[report]"') from None


@contextmanager
def drawing(salt: str) -> Iterator[None]:
    """Draw in the study's style; ``salt`` names the figure's parts."""
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": salt}, fname=_STYLE), warnings.catch_warnings():
        # A name may hold letters that the font lacks; the box in their place says so.
        warnings.filterwarnings("ignore", message=r"Glyph \d+")
        yield


def save(figure: "Figure", path: Path) -> None:
    """Write a figure in the format of the suffix; the same figure is the same bytes."""
    stamp = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix)
    drawn = io.BytesIO()  # of a disk that is full, matplotlib says nearly anything
    with drawing(path.stem):
        figure.savefig(drawn, format=path.suffix[1:], metadata=stamp, dpi=200)
    path.write_bytes(drawn.getvalue())


def as_svg(figure: "Figure", name: str) -> str:
    """A figure as an ``<svg>`` element for a page; ``name`` keeps its identifiers apart from other figures'."""
    text = io.StringIO()
    with drawing(name):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure, in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def level_color(level: float) -> Any:
    """An answer's colour, from -1 (ours) to 1 (theirs): deep at the ends, grey in the middle."""
    from matplotlib.colors import LinearSegmentedColormap

    color, mixed = ((OURS, "#8fbccb"), (THEIRS, "#eab48c"))[level > 0]
    return LinearSegmentedColormap.from_list("side", [NEUTRAL, mixed, color])(abs(level))


def level_labels(levels: Sequence[float]) -> list[str]:
    """The answers in words; of more than five, the ends and the middle alone."""
    words = {-1.0: "ours much better", 0.0: "no difference", 1.0: "theirs much better"}
    if len(levels) <= 5:
        words |= {-0.5: "ours better", 0.5: "theirs better"}
    return [words.get(level, "") for level in levels]


def _relative(question: QuestionAnalysis) -> np.ndarray:
    """A question's levels, from -1 to 1."""
    scale = question.responses.scale
    return (np.array(question.levels) - scale.midpoint) / (scale.high - scale.midpoint)


def likert(analysis: Analysis) -> "Figure":
    """Diverging bars: how often each answer was given, centred on the neutral one, with counts."""
    from matplotlib.patches import Patch

    with drawing("likert"):
        questions = analysis.questions
        figure = new_figure(7.0, 1.15 + 0.5 * len(questions))
        axes = figure.add_subplot()
        levels = sorted({float(level) for question in questions for level in _relative(question)})
        ends = [_likert_row(axes, row, question) for row, question in enumerate(questions)]
        half_width = 1.02 * max(max(-left, right) for left, right in ends)
        axes.set_xlim(-half_width, half_width)
        axes.axvline(0, color=INK, linewidth=0.7, zorder=0)
        axes.set_yticks(range(len(questions)), [_wrapped(question.title) for question in questions])
        axes.tick_params(axis="y", length=0, labelsize=8)
        axes.spines["left"].set_visible(False)
        axes.invert_yaxis()
        axes.xaxis.set_major_formatter(lambda value, _: f"{abs(value):.0%}")
        axes.set_xlabel("← ours preferred        share of the answers        theirs preferred →")
        if len(levels) <= 21:
            named = zip(levels, level_labels(levels), strict=True)
            handles = [Patch(color=level_color(level), label=name) for level, name in named]
            figure.legend(
                handles=handles,
                loc="outside upper center",
                ncols=len(levels),
                frameon=False,
                fontsize=7.5,
                handlelength=1,
                handletextpad=0.4,
                columnspacing=1.2,
            )
        return figure


def _likert_row(axes: "Axes", row: int, question: QuestionAnalysis) -> tuple[float, float]:
    counts, levels = np.array(question.counts, dtype=float), _relative(question)
    fractions = counts / counts.sum()
    left = -float(fractions[levels < 0].sum() + fractions[levels == 0].sum() / 2)
    start = left
    for level, count, fraction in zip(levels.tolist(), question.counts, fractions, strict=True):
        axes.barh(row, fraction, left=left, height=0.62, color=level_color(level), edgecolor="white", linewidth=0.6)
        edge = {levels[0]: ("right", left), levels[-1]: ("left", left + fraction)}.get(level)
        if fraction <= 0.028 and count and edge:
            side, position = edge
            gap = -0.006 if side == "right" else 0.006
            axes.text(position + gap, row, f"{count}", ha=side, va="center", fontsize=7.5, color=SOFT)
        elif fraction > 0.028:
            color = "white" if abs(level) > 0.6 else INK
            axes.text(left + fraction / 2, row, f"{count}", ha="center", va="center", fontsize=7.5, color=color)
        left += float(fraction)
    return start, left


def _wrapped(text: str, width: int = 26) -> str:
    import textwrap

    return "\n".join(textwrap.wrap(text, width)[:3])


def means(analysis: Analysis) -> "Figure":
    """Means of participants and of items with intervals, sorted, beside the mean of all and its interval."""
    with drawing("means"):
        questions = analysis.questions
        people = max(len(question.by_participant.names) for question in questions)
        items = max(len(question.by_item.names) for question in questions)
        heights = [_rows_height(people), _rows_height(items)]
        figure = new_figure(1.0 + 2.1 * max(len(questions), 1.6), 0.9 + sum(heights))
        grid = figure.subplots(2, len(questions), sharex=True, squeeze=False, height_ratios=heights)
        spread = np.concatenate([_edges(side) for q in questions for side in (q.by_participant, q.by_item)])
        limit = 1.05 * float(np.abs(spread).max(initial=0.5))
        for column, question in enumerate(questions):
            for row, (side, name) in enumerate(((question.by_participant, "participants"), (question.by_item, "sets"))):
                axes = grid[row, column]
                _caterpillar(axes, side, question, named=len(side.names) <= _NAMED_ROWS and len(questions) <= 4)
                axes.set_xlim(-limit, limit)
                axes.set_title(f"{len(side.names)} {name}", fontsize=7.5, color=SOFT)
            grid[0, column].annotate(
                _wrapped(question.title, 28),
                (0, 1),
                xytext=(0, 16),
                xycoords="axes fraction",
                textcoords="offset points",
                fontsize=9,
                fontweight="bold",
                va="bottom",
            )
        figure.supxlabel("← ours preferred      mean answer, relative to neutral      theirs preferred →", fontsize=8)
        return figure


def _rows_height(rows: int) -> float:
    return 0.5 + 0.085 * max(rows, 6) if rows <= _NAMED_ROWS else 3.6


def _edges(side: Means) -> np.ndarray:
    half_width = np.where(np.isfinite(side.half_width), side.half_width, 0)
    return np.concatenate([side.means - half_width, side.means + half_width])


def _caterpillar(axes: "Axes", side: Means, question: QuestionAnalysis, named: bool) -> None:
    order = np.argsort(side.means, kind="stable")
    centers, half_width = side.means[order], np.where(np.isfinite(side.half_width), side.half_width, 0)[order]
    rows = np.arange(len(order))
    colors = np.where(centers + half_width < 0, OURS, np.where(centers - half_width > 0, THEIRS, "#8b9097"))
    if question.primary is not None:
        low, high = np.clip(question.primary.result.interval, -9e9, 9e9)
        axes.axvspan(low, high, color="#e8eef1", linewidth=0, zorder=0)
    axes.axvline(float(question.responses.deviations.mean()), color=INK, linewidth=0.8, linestyle=(0, (4, 2)))
    axes.axvline(0, color=INK, linewidth=0.7, zorder=1)
    crowded = len(order) > _NAMED_ROWS
    axes.hlines(
        rows, centers - half_width, centers + half_width, colors=colors.tolist(), linewidth=0.4 if crowded else 0.9
    )
    axes.scatter(centers, rows, s=1.5 if crowded else 7, c=colors.tolist(), zorder=3, linewidths=0)
    axes.set_ylim(len(order) - 0.3, -0.7)
    axes.set_yticks(rows if named else [], [side.titles[index][:24] for index in order] if named else [])
    axes.tick_params(axis="y", labelsize=4.6, length=0, pad=1)
    axes.spines["left"].set_visible(False)


def positions(analysis: Analysis) -> "Figure":
    """Whether the preference depends on the side: ours shown as A, ours shown as B, and the lean to a side."""
    from anystyle.study.tabulate import p_text

    with drawing("positions"):
        questions = [question for question in analysis.questions if question.position is not None]
        figure = new_figure(7.0, 0.9 + 0.62 * max(len(questions), 1))
        axes = figure.add_subplot()
        limit = 0.5
        for row, question in enumerate(questions):
            assert question.position is not None
            by_side = (question.position.mean_as_a, question.position.mean_as_b)
            for offset, (mean, half_width), marker, label in zip((-0.14, 0.14), by_side, "os", "AB", strict=True):
                error = half_width if math.isfinite(half_width) else 0.0
                limit = max(limit, abs(mean) + error)
                axes.errorbar(
                    mean,
                    row + offset,
                    xerr=error,
                    fmt=marker,
                    color=OURS if label == "A" else "#7a5195",
                    markersize=4.5,
                    linewidth=1.1,
                    label=f"ours shown as {label}" if row == 0 else None,
                )
            bias, pvalue = question.position.bias, math.exp(question.position.log_pvalue)
            note = f"lean to a side: {bias:+.2f}".replace("-", "−") + f", p {p_text(pvalue)}"
            axes.annotate(
                note, (1, row), xycoords=("axes fraction", "data"), xytext=(4, 0), textcoords="offset points",
                va="center", fontsize=7, color=SOFT,
            )  # fmt: skip
        axes.axvline(0, color=INK, linewidth=0.7, zorder=0)
        axes.set_xlim(-1.08 * limit, 1.08 * limit)
        axes.set_ylim(len(questions) - 0.5, -0.5)
        axes.set_yticks(range(len(questions)), [_wrapped(question.title) for question in questions])
        axes.tick_params(axis="y", length=0, labelsize=8)
        axes.spines["left"].set_visible(False)
        axes.set_xlabel("← ours preferred      mean answer, relative to neutral      theirs preferred →")
        if questions:
            figure.legend(loc="outside upper center", ncols=2, frameon=False, fontsize=7.5)
        return figure


# Okabe and Ito's colours, told apart by everybody.
_PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#332288", "#117733")
_MARKERS = {"response": "x", "participant": "o", "item": "s"}


def power(study: PowerStudy) -> "Figure":
    """On the left false positives without a preference, on the right how often a preference is found."""
    with drawing("power"):
        figure = new_figure(7.2, 3.5)
        axes = figure.subplots(1, 2)
        colors = _colors(study)
        for test in study.tests:
            _curve(axes[0], study.rates(*test, null=True), colors[test])
            _curve(axes[1], study.rates(*test), colors[test])
        people = sorted({rate.scenario.participants for rate in study.power})
        effect = study.power[0].scenario.effect
        titles = ("False positives: no preference", f"Power: a preference of {abs(effect):g} points")
        for side, title, line in zip(axes, titles, (study.level, study.target), strict=True):
            side.set_title(title)
            side.axhline(line, color=INK, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0)
            side.set_xscale("log")
            side.set_xticks(people, [str(number) for number in people])
            side.minorticks_off()
            side.set_xlabel("participants")
            side.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
            side.grid(axis="y", color="#e6e8eb", linewidth=0.6)
            side.set_axisbelow(True)
        axes[0].set_ylim(0, max(0.12, 1.05 * max(rate.interval()[1] for rate in study.null)))
        axes[1].set_ylim(0, 1.03)
        axes[0].annotate(
            "nominal level",
            (people[-1], study.level),
            xytext=(0, 3),
            textcoords="offset points",
            ha="right",
            fontsize=6.5,
            color=SOFT,
        )
        figure.legend(
            *axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=7
        )
        return figure


def _colors(study: PowerStudy) -> dict[tuple[str, Unit], str]:
    """Grey for tests that stand for nobody else, a colour of its own for each of the others."""
    naive = {(rate.test, rate.unit) for rate in study.power if not rate.holds_for}
    palette = cycle(_PALETTE)
    return {test: "#9aa0a6" if test in naive else next(palette) for test in study.tests}


def _curve(axes: "Axes", rates: list[Rate], color: str) -> None:
    people = [rate.scenario.participants for rate in rates]
    fractions = [rate.fraction for rate in rates]
    bounds = [rate.interval() for rate in rates]
    axes.fill_between(people, [low for low, _ in bounds], [high for _, high in bounds], color=color, alpha=0.13, lw=0)
    axes.plot(
        people,
        fractions,
        color=color,
        marker=_MARKERS[rates[0].unit],
        markersize=3.5,
        linewidth=1.2,
        linestyle="-" if rates[0].holds_for else (0, (2, 1.5)),
        label=f"{rates[0].test.replace('_', ' ')}, {rates[0].unit}s",
    )
