"""Plots of a study: answers, means, positions, power. Left of 0 prefers ours."""

import io
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from anystyle_study.analysis import Analysis, Mean, QuestionAnalysis
from anystyle_study.power import PowerStudy, Rate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OURS, NEUTRAL, THEIRS = "#1f6f8b", "#dcdcd8", "#c8642b"
_INK, _SOFT = "#24292e", "#6b7280"
_MAX_NAMED = 45  # rows; names of more would overlap
_AXIS = "← ours preferred      mean answer, relative to neutral      theirs preferred →"
_LABELS = {-1.0: "ours much better", 0.0: "no difference", 1.0: "theirs much better"}
# Okabe and Ito's colours, distinct under colour blindness.
_PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#332288", "#117733")
_MARKERS = {"response": "x", "participant": "o", "item": "s"}


@contextmanager
def _style(salt: str) -> Iterator[None]:
    """Drawing in the study's style; ``salt`` is the prefix of SVG identifiers."""
    import matplotlib

    file = Path(__file__).parent / "pages" / "figures.mplstyle"
    with matplotlib.rc_context({"svg.hashsalt": salt}, fname=file), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph \d+")  # names may have letters that the font lacks
        yield


def _figure(width: float, height: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save(figure: "Figure", path: Path) -> None:
    """Write a plot as ``PATH.pdf`` and ``PATH.svg``, reproducible to the byte."""
    for suffix, stamp in (("pdf", "CreationDate"), ("svg", "Date")):
        drawn = io.BytesIO()  # matplotlib does not report a full disk plainly
        with _style(path.name):
            figure.savefig(drawn, format=suffix, metadata={stamp: None}, dpi=200)
        path.with_suffix(f".{suffix}").write_bytes(drawn.getvalue())


def as_svg(figure: "Figure", name: str) -> str:
    """A plot as an ``<svg>`` element; ``name`` distinguishes its identifiers from those of other plots."""
    text = io.StringIO()
    with _style(name):
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()[text.getvalue().index("<svg") :]


def _wrapped(text: str, width: int = 26) -> str:
    return "\n".join(textwrap.wrap(text, width)[:3])


def _level_color(level: float) -> Any:
    """Colour of an answer from -1 (ours) to 1 (theirs)."""
    from matplotlib.colors import LinearSegmentedColormap

    color, mixed = (THEIRS, "#eab48c") if level > 0 else (OURS, "#8fbccb")
    return LinearSegmentedColormap.from_list("side", [NEUTRAL, mixed, color])(abs(level))


def likert(analysis: Analysis) -> "Figure":
    """Diverging bars: the number of times each answer was given, centred on the neutral one."""
    from matplotlib.patches import Patch

    with _style("likert"):
        figure = _figure(7.0, 1.15 + 0.5 * len(analysis.questions))
        axes = figure.add_subplot()
        bars = [_likert_row(axes, row, question) for row, question in enumerate(analysis.questions)]
        axes.axvline(0, color=_INK, linewidth=0.7, zorder=0)
        axes.set_ylim(len(bars) - 0.5, -0.5)
        axes.set_yticks(range(len(bars)), [_wrapped(question.title) for question in analysis.questions])
        axes.tick_params(axis="y", length=0, labelsize=8)
        axes.spines["left"].set_visible(False)
        extent = 1.02 * max(extent for _, extent in bars)
        axes.set_xlim(-extent, extent)
        axes.xaxis.set_major_formatter(lambda value, _: f"{abs(value):.0%}")
        axes.set_xlabel("← ours preferred        fraction of the answers        theirs preferred →")
        levels = sorted({level for row, _ in bars for level in row})
        if len(levels) <= 21:
            labels = _LABELS | {-0.5: "ours better", 0.5: "theirs better"} if len(levels) <= 5 else _LABELS
            handles = [Patch(color=_level_color(level), label=labels.get(level, "")) for level in levels]
            look: dict[str, Any] = {"frameon": False, "fontsize": 7.5, "handlelength": 1, "columnspacing": 1.2}
            figure.legend(handles=handles, loc="outside upper center", ncols=len(levels), **look)
        return figure


def _likert_row(axes: "Axes", row: int, question: QuestionAnalysis) -> tuple[list[float], float]:
    """Draw a question's bar; its levels from -1 to 1, and how far it reaches from the centre."""
    scale = question.responses.scale
    levels = (np.array(list(question.distribution)) - scale.midpoint) / (scale.high - scale.midpoint)
    counts = np.array(list(question.distribution.values()))
    fractions = counts / counts.sum()
    start = left = -float(fractions[levels < 0].sum() + fractions[levels == 0].sum() / 2)
    for level, count, fraction in zip(levels.tolist(), counts.tolist(), fractions.tolist(), strict=True):
        axes.barh(row, fraction, left=left, height=0.62, color=_level_color(level), edgecolor="white", linewidth=0.6)
        if fraction > 0.028:  # wide enough for its number
            look: dict[str, Any] = {"va": "center", "fontsize": 7.5, "color": "white" if abs(level) > 0.6 else _INK}
            axes.text(left + fraction / 2, row, f"{count}", ha="center", **look)
        left += fraction
    return levels.tolist(), max(-start, left)


def means(analysis: Analysis) -> "Figure":
    """Means of participants and of sets with intervals, sorted, beside the overall mean and its interval."""
    questions = analysis.questions
    with _style("means"):
        sides = [(one.by_participant, one.by_item) for one in questions]
        most = [max(map(len, column)) for column in zip(*sides, strict=True)]
        heights = [0.5 + 0.085 * max(rows, 6) if rows <= _MAX_NAMED else 3.6 for rows in most]
        figure = _figure(1.0 + 2.1 * max(len(questions), 1.6), 0.9 + sum(heights))
        grid = figure.subplots(2, len(questions), sharex=True, squeeze=False, height_ratios=heights)
        ends = [0.5, *(end for pair in sides for side in pair for one in side for end in (one.mean, *one.interval))]
        limit = 1.05 * float(np.nanmax(np.abs(ends)))
        grid[0, 0].set_xlim(-limit, limit)
        for column, question in enumerate(questions):
            for row, name in enumerate(("participants", "sets")):
                axes, side = grid[row, column], sides[column][row]
                _caterpillar(axes, side, question, named=len(side) <= _MAX_NAMED and len(questions) <= 4)
                axes.set_title(f"{len(side)} {name}", fontsize=7.5, color=_SOFT)
            text: dict[str, Any] = {"fontsize": 9, "fontweight": "bold", "va": "bottom"}
            text |= {"xytext": (0, 16), "xycoords": "axes fraction", "textcoords": "offset points"}
            grid[0, column].annotate(_wrapped(question.title, 22), (0, 1), **text)
        figure.supxlabel(_AXIS, fontsize=8)
        return figure


def _caterpillar(axes: "Axes", side: Sequence[Mean], question: QuestionAnalysis, named: bool) -> None:
    ordered = sorted(side, key=lambda one: one.mean)
    centers, half_width = np.nan_to_num([(one.mean, one.half_width) for one in ordered]).T
    rows = np.arange(len(ordered))
    colors = np.where(centers + half_width < 0, OURS, np.where(centers - half_width > 0, THEIRS, "#8b9097")).tolist()
    if question.primary is not None:
        low, high = np.clip(question.primary.result.interval, -9e9, 9e9)
        axes.axvspan(low, high, color="#e8eef1", linewidth=0, zorder=0)
    axes.axvline(float(question.responses.deviations.mean()), color=_INK, linewidth=0.8, linestyle=(0, (4, 2)))
    axes.axvline(0, color=_INK, linewidth=0.7, zorder=1)
    crowded = len(ordered) > _MAX_NAMED
    axes.hlines(rows, centers - half_width, centers + half_width, colors=colors, linewidth=0.4 if crowded else 0.9)
    axes.scatter(centers, rows, s=1.5 if crowded else 7, c=colors, zorder=3, linewidths=0)
    axes.set_ylim(len(ordered) - 0.3, -0.7)
    axes.set_yticks(rows if named else [], [one.title[:24] for one in ordered] if named else [])
    axes.tick_params(axis="y", labelsize=4.6, length=0, pad=1)
    axes.spines["left"].set_visible(False)


def power(study: PowerStudy) -> "Figure":
    """False-positive rate (left) and power (right) over the number of participants."""
    with _style("power"):
        figure = _figure(7.2, 3.5)
        left, right = figure.subplots(1, 2)
        palette = cycle(_PALETTE)
        for rates in study.by_test.values():
            color = next(palette) if rates[0].generalizes_to else "#9aa0a6"
            for side, name in ((left, "false_positive"), (right, "power")):
                _curve(side, rates, name, color)
        people = list(dict.fromkeys(rate.participants for rate in study.rates))
        titles = ("False positives: no preference", f"Power: a preference of {abs(study.scenario.effect):g} points")
        for side, title, line in zip((left, right), titles, (study.level, study.target), strict=True):
            side.set_title(title)
            side.axhline(line, color=_INK, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0)
            side.set(xscale="log", xlabel="participants")
            side.set_xticks(people, [str(number) for number in people])
            side.minorticks_off()
            side.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
            side.grid(axis="y", color="#e6e8eb", linewidth=0.6)
            side.set_axisbelow(True)
        left.set_ylim(0, max(0.12, 1.05 * max(rate.false_positive_interval[1] for rate in study.rates)))
        right.set_ylim(0, 1.03)
        where: dict[str, Any] = {"xytext": (0, 3), "textcoords": "offset points", "ha": "right"}
        left.annotate("nominal level", (people[-1], study.level), fontsize=6.5, color=_SOFT, **where)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=7)
        return figure


def _curve(axes: "Axes", rates: Sequence[Rate], name: str, color: str) -> None:
    people, first = [rate.participants for rate in rates], rates[0]
    heights = [rate.power if name == "power" else rate.false_positive_rate for rate in rates]
    low, high = zip(*(getattr(rate, f"{name}_interval") for rate in rates), strict=True)
    axes.fill_between(people, low, high, color=color, alpha=0.13, lw=0)
    look: dict[str, Any] = {"marker": _MARKERS[first.unit], "markersize": 3.5, "linewidth": 1.2, "color": color}
    look["linestyle"] = "-" if first.generalizes_to else (0, (2, 1.5))
    axes.plot(people, heights, label=f"{first.test.replace('_', ' ')}, {first.unit}s", **look)
