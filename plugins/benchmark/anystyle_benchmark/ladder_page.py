"""What a ladder looks like: a picture of all verdicts, a strip of its rungs, a page with both, and a table."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from anystyle.data.images import open_image
from anystyle.evaluation.tables import STAND_IN, Table, titled
from anystyle.io.documents import as_number
from anystyle.io.sheet import contact_sheet
from anystyle_benchmark.distortions import DISTORTIONS
from anystyle_benchmark.ladder import BLIND, STEPS, WORDS, Ladder, Verdict, expectations, rung, title
from anystyle_benchmark.results import Cell
from anystyle_benchmark.templates import templates

CELL = (160, 120)
"""Largest width and height of a picture in the strip of rungs, in pixels."""


class Look(NamedTuple):
    """How a kind of verdict is drawn: ground, ink, and a word that fits."""

    ground: str
    ink: str
    word: str


# Okabe and Ito's hues, distinct under colour blindness; failures are the only strong warm ones.
LOOKS = {
    "orders": Look("#0b7a5b", "#ffffff", "orders"),
    "orders_part": Look("#a5dcc8", "#12352a", "in part"),
    "inverted": Look("#d9d2ec", "#33264f", "rewards, by design"),
    "blind": Look("#e9eaec", "#4a525a", "blind, by design"),
    "fails_blind": Look("#f0b93a", "#3d2a00", "FAILS: blind"),
    "fails_inverted": Look("#c2410c", "#ffffff", "FAILS: inverted"),
    "unforeseen_worse": Look("#cfe6f5", "#17374d", "sees, unforeseen"),
    "unforeseen_better": Look("#f7cfdd", "#5a1533", "rewards, unforeseen"),
    "unclaimed_worse": Look("#ffffff", "#5a626b", "worse, no claim"),
    "unclaimed_better": Look("#ffffff", "#5a626b", "better, no claim"),
    "unclaimed_blind": Look("#ffffff", "#5a626b", "blind, no claim"),
    "undecided": Look("#ffffff", "#5a626b", "undecided"),
}


def picture(ladder: Ladder) -> str:
    """All verdicts as an SVG picture: figures down, distortions across."""
    kinds = [kind for kind in LOOKS if any(verdict.kind == kind for verdict in ladder.verdicts)]
    return templates().get_template("ladder.svg").render(_values(ladder), kinds=kinds)


def ladder_page(ladder: Ladder, strip: str = "") -> str:
    """The page; ``strip`` is the address of the picture of the rungs, if there is one."""
    values = {"picture": picture(ladder), "strip": strip, "expectations": expectations()}
    return templates().get_template("ladder.html").render(_values(ladder), **values)


def _values(ladder: Ladder) -> dict[str, object]:
    figures = [name for name in ladder.metrics if ladder.of(name)]
    present = [name for name in DISTORTIONS if any(verdict.distortion == name for verdict in ladder.verdicts)]
    return {
        "ladder": ladder,
        "figures": figures,
        "distortions": {name: DISTORTIONS[name] for name in present},
        "verdicts": {(verdict.figure, verdict.distortion): verdict for verdict in ladder.verdicts},
        "looks": LOOKS,
        "words": WORDS,
        "steps": STEPS,
        "blind": BLIND,
        "count": count,
        "bounds": bounds,
        "as_number": as_number,
        "sizes": sizes(ladder),
    }


def count(verdict: Verdict) -> str:
    """How many steps are in order, on average."""
    mean = as_number(verdict.ordered.mean)
    return "–" if mean != mean else f"{mean:.1f}"


def bounds(verdict: Verdict) -> str:
    """The interval of this number, within what is possible."""
    ends = [min(max(as_number(end), 0.0), float(STEPS)) for end in (verdict.ordered.low, verdict.ordered.high)]
    known = as_number(verdict.ordered.low) == as_number(verdict.ordered.low)
    return f"[{ends[0]:.1f}, {ends[1]:.1f}]" if known else ""


def sizes(ladder: Ladder) -> str:
    """How much was measured, in words."""
    counted = ((ladder.scenes, "scene"), (ladder.styles, "style"))
    parts = [f"{len(names)} {what}{'s' * (len(names) != 1)}" for names, what in counted]
    return f"{' x '.join(parts)}, {ladder.views} views per cell, by the method {ladder.method.name}"


def table(ladder: Ladder) -> Table:
    """Figures down, distortions across: how many steps are in order, and the verdict in words."""
    verdicts = {(one.figure, one.distortion): one for one in ladder.verdicts}
    present = [name for name in DISTORTIONS if any(one.distortion == name for one in ladder.verdicts)]
    better = {name: info.better for name, info in ladder.metrics.items()}
    rows = [
        (titled(name, better), *(_told(verdicts.get((name, distortion))) for distortion in present))
        for name in ladder.metrics
        if ladder.of(name)
    ]
    networks = {name: ladder.metrics[name].stand_in for name in ladder.metrics if ladder.metrics[name].stand_in}
    notes = (
        f"How many of {STEPS} steps to the next rung move the figure as it is said to (to the worse, where nothing is "
        f"said). Verdicts are of Kendall's tau of rung and figure: its 95 % interval for new scenes and styles "
        f"leaves 0 out; lies within {BLIND:g} of 0 (blind); or neither (undecided). {sizes(ladder)}; track "
        f"{ladder.track.name} {ladder.track.version}.",
        *(f"{name}: {network} ({STAND_IN})." for name, network in networks.items()),
    )
    return Table(("figure", *map(title, present)), tuple(rows), notes=notes)


def _told(verdict: Verdict | None) -> str:
    return "–" if verdict is None else f"{count(verdict)} {WORDS[verdict.kind]}"


def strip(root: Path, distortions: Sequence[str], scene: str, style: str, view: str) -> Image.Image:
    """A view on every rung of every distortion, in rows."""
    rows = [
        [
            open_image(Cell(rung(name, index), 0, scene, style).images(root) / f"{view}.png")
            for index in range(STEPS + 1)
        ]
        for name in distortions
    ]
    strengths = {name: ", ".join(f"{one:g}" for one in DISTORTIONS[name].strengths) for name in distortions}
    titles = [f"{title(name)} ({strengths[name]})" for name in distortions]
    columns = ["as it is", *(f"rung {index}" for index in range(1, STEPS + 1))]
    return contact_sheet(rows, row_titles=titles, column_titles=columns, cell=CELL, gap=5)
