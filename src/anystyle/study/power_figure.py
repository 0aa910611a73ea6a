"""Power and false positives over numbers of participants, as a figure."""

from itertools import cycle
from typing import TYPE_CHECKING

from anystyle.study.contract import Unit
from anystyle.study.figures import INK, SOFT, drawing, new_figure
from anystyle.study.power import PowerStudy, Rate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by everybody.
_PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#332288", "#117733")
_MARKERS = {"response": "x", "participant": "o", "item": "s"}


def power(study: PowerStudy) -> "Figure":
    """On the left false positives without a preference, on the right how often a preference is found."""
    with drawing("power"):
        figure = new_figure(7.2, 3.5)
        axes = figure.subplots(1, 2)
        colors = _colors(study)
        for one in study.tests:
            _curve(axes[0], study.rates(*one, null=True), colors[one])
            _curve(axes[1], study.rates(*one), colors[one])
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
    return {one: "#9aa0a6" if one in naive else next(palette) for one in study.tests}


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
