"""``anystyle benchmark compare``: by which scores methods differ, in the cells that both have."""

import argparse
import math
from collections.abc import Sequence
from itertools import combinations, groupby
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from anystyle.cli.arguments import new_parser, parse
from anystyle.errors import UserError, check_known
from anystyle.evaluation.tables import Table, number, titled
from anystyle.io.atomic import write_json, write_text
from anystyle.io.documents import Number, as_number, stored_number
from anystyle_benchmark.judge import GUIDES
from anystyle_benchmark.results import Figures, read_figures
from anystyle_benchmark.statistics import CONFIDENCE, arranged, difference
from anystyle_study.statistics import holm
from anystyle_study.wording import p_text


class Compared(Struct, frozen=True):
    """A score of two methods in the ``n`` cells (or scenes) that both have: means, and first minus second.

    The 95 % interval is for new scenes and styles, ``holm`` the two-sided ``pvalue`` adjusted over all scores, guides
    and pairs; ``None`` where there are too few to say. ``better`` is empty where the two cannot be told apart.
    """

    first: str
    second: str
    guide: str
    figure: str
    means: tuple[Number, Number]
    difference: Number
    low: Number
    high: Number
    pvalue: Number
    holm: Number
    n: int
    better: str = ""


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark compare``."""
    flags = new_parser("benchmark compare", "Test by which scores methods differ, in the cells that both have.")
    add = flags.add_argument
    add("results", type=Path, help="a folder that `anystyle benchmark judge` judged, or its figures.json")
    add("methods", nargs="+", metavar="METHOD", help="two or more")
    add("--out", type=Path, metavar="DIR", help="write compare.md, compare.csv and compare.json there")
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark compare``."""
    arguments = parse(parser(), args)
    figures = read_figures(arguments.results)
    found = compare(figures, arguments.methods)
    listed = table(found, figures)
    text = "\n".join([listed.markdown(), *(f"- {line}" for line in sentences(found))])
    print(text)
    if (out := arguments.out) is not None:
        write_json(out / "compare.json", {"figures": msgspec.to_builtins(found)})
        write_text(out / "compare.md", f"{text}\n")
        write_text(out / "compare.csv", listed.csv())


def compare(figures: Figures, methods: Sequence[str]) -> list[Compared]:
    """Every score of every two methods."""
    if len(set(methods)) != len(methods) or len(methods) < 2:
        raise UserError("name two methods or more, each once")
    check_known("method in these results", methods, figures.methods)
    rows = [*figures.cells, *figures.scenes]
    found: list[Compared] = []
    for pair in combinations(methods, 2):
        before = len(found)
        for guide in GUIDES:
            groups = [[row for row in rows if (row.method, row.guide) == (method, guide)] for method in pair]
            for figure in figures.metrics:
                first, second = arranged(figure, *groups)
                both = ~np.isnan(first) & ~np.isnan(second)
                if both.any():
                    gap = difference(first, second)
                    mean, low, high, pvalue = map(stored_number, gap[:4])
                    means = stored_number(float(first[both].mean())), stored_number(float(second[both].mean()))
                    found.append(Compared(*pair, guide, figure, means, mean, low, high, pvalue, None, gap.n))
        if len(found) == before:
            raise UserError(f"{' and '.join(pair)} have no score in the same cell; leave one of them out")
    decided: list[Compared] = []
    for one, pvalue in zip(found, holm([as_number(one.pvalue) for one in found]), strict=True):
        ahead = (as_number(one.difference) > 0) == (figures.metrics[one.figure].better == "higher")
        name = (one.first if ahead else one.second) if pvalue <= 1 - CONFIDENCE else ""
        decided.append(msgspec.structs.replace(one, holm=stored_number(pvalue), better=name))
    return decided


def sentences(found: Sequence[Compared]) -> list[str]:
    """Which scores differ and which do not, a line for each pair and guide."""
    lines: list[str] = []
    for (first, second, guide), block in groupby(found, lambda one: (one.first, one.second, one.guide)):
        rows = list(block)
        better = {method: [one.figure for one in rows if one.better == method] for method in (first, second)}
        parts = [f"{method} is better by {', '.join(names)}" for method, names in better.items() if names]
        if same := [one.figure for one in rows if not one.better]:
            parts.append(f"they cannot be told apart by {', '.join(same) if parts else 'any score'}")
        lines.append(f"{first} and {second}, by {guide}s: {'; '.join(parts)}.")
    return lines


def table(found: Sequence[Compared], figures: Figures) -> Table:
    """A row for each pair, guide and score."""
    better = {name: info.better for name, info in figures.metrics.items()}
    rows: list[tuple[str, ...]] = []
    for one in found:
        means = [number(as_number(value)) for value in (*one.means, one.difference)]
        low, high, pvalue = map(as_number, (one.low, one.high, one.holm))
        interval = "–" if math.isnan(low) else f"[{number(low)}, {number(high)}]"
        adjusted = "–" if math.isnan(pvalue) else p_text(pvalue).removeprefix("= ")
        of = f"{one.first}, {one.second}", one.guide, titled(one.figure, better)
        rows.append((*of, *means, interval, adjusted, one.better or "–"))
    note = (
        "Differences are of the first and the second method in the cells (or scenes) that both have. Intervals and p "
        "are Student's over crossed random scenes and styles; p is adjusted over all rows by Holm's method, intervals "
        "are not. A method is better where p is at most 0.05. A difference that is the same in every cell has no test."
    )
    columns = ("methods", "guide", "score", "first", "second", "difference", "95 % interval", "p (Holm)", "better")
    return Table(columns, tuple(rows), notes=(note,))
