"""``anystyle benchmark judge``: the scores of results, or what is wrong with somebody's images."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.progress import progress_lines
from anystyle.errors import UserError
from anystyle.evaluation.tables import STAND_IN, Table, number, titled
from anystyle.io.atomic import write_json, write_text
from anystyle.io.documents import as_number
from anystyle.io.limits import free
from anystyle_benchmark.judge import Judge, inputs_of, read_methods, wrong
from anystyle_benchmark.results import FIGURES, Figures, Interval, bind, differing, joined, read_figures
from anystyle_benchmark.statistics import cost
from anystyle_benchmark.track import Inputs

PROCESS = 2 * 2**30
"""Bytes that a process which judges takes, at most, on the bundled tracks."""
INTERVALS = (
    "Means over scenes and styles, ± half of the 95 % interval for new scenes and styles (pigeonhole bootstrap; of "
    "figures that a scene has over all its styles, for new scenes). Failed cells are left out."
)


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark judge``."""
    flags = new_parser(
        "benchmark judge",
        "Compute the track's scores of every method in a folder of results. Writes figures.json, table.md and "
        "table.csv there; only what changed is computed again.",
    )
    add = flags.add_argument
    add("results", nargs="?", type=Path, help="the folder that `anystyle benchmark run` filled")
    add("--track", metavar="NAME", help="a track, or a track.toml (default: that of the results)")
    add_judging(flags)
    beside = "also show the methods of these judged results (a folder, or figures.json) that the folder lacks"
    add("--beside", type=Path, metavar="RESULTS", help=beside)
    check = "judge nothing; list what is wrong with images SCENE/STYLE/VIEW.png"
    add("--check", type=Path, metavar="FOLDER", help=check)
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark judge``."""
    arguments = parse(parser(), args)
    if (folder := arguments.check) is not None:
        if arguments.track is None:
            raise UserError("--check needs --track NAME: the track that the images are for")
        inputs = Inputs(arguments.track, arguments.root)
        lines = wrong(inputs, folder)
        whole = f"every image of {folder} can be judged on {inputs.track.name} {inputs.track.version}"
        print("\n".join(lines) or whole)
        if lines:
            raise UserError(f"{len(lines)} thing{'s are' if len(lines) > 1 else ' is'} wrong with {folder}")
        return
    if (results := arguments.results) is None:
        raise UserError("name the folder of results, or --check FOLDER")
    specs = read_methods(results)
    inputs = inputs_of(results, arguments.track, arguments.root)
    lock = bind(inputs, results)
    judge = Judge(inputs, results, words_of(arguments.metrics), processes=processes_of(arguments))
    others = None if arguments.beside is None else read_figures(arguments.beside)
    if others is not None and (reason := differing(lock, judge.infos, others)):
        raise UserError(f"{arguments.beside} cannot be shown beside {results}: {reason}")
    figures = judge(specs, lock, progress_lines())
    if others is not None:
        figures = joined(figures, others)
    write_json(results / FIGURES, msgspec.to_builtins(figures))
    table = summary(figures).markdown()
    write_text(results / "table.md", table)
    write_text(results / "table.csv", listing(figures).csv())
    for cell in figures.cells:
        if cell.message:
            print(f"{cell.status}: {', '.join(map(str, cell.cell))}: {cell.message}", file=sys.stderr)
    print(f"{table}\nin {results}: {FIGURES}, table.md, table.csv")


def add_judging(flags: argparse.ArgumentParser) -> None:
    """Give a command the flags of a judge; :func:`processes_of` reads how many processes judge."""
    add = flags.add_argument
    about = "how many processes judge at once (default: one for each core, as far as memory goes)"
    add("--root", type=Path, metavar="DIR", help="where the track's inputs lie (default: beside its file)")
    add("--metrics", default="", metavar="A,B", help="only these of the track's metrics")
    add("--processes", type=int, metavar="N", help=about)


def words_of(text: str) -> list[str]:
    """What commas separate."""
    return list(filter(None, text.split(",")))


def processes_of(arguments: argparse.Namespace) -> int:
    """How many processes judge at once."""
    if arguments.processes is not None and arguments.processes < 1:
        raise UserError(f"--processes {arguments.processes}; give 1 or more")
    return arguments.processes or max(1, min(os.cpu_count() or 1, free() // PROCESS))


def summary(figures: Figures) -> Table:
    """Methods down, by each guide, and metrics across."""
    # The first figure of each metric.
    firsts = {info.metric or name: name for name, info in reversed(figures.metrics.items())}.values()
    shown = [name for name in figures.metrics if name in firsts and any(name in row.figures for row in figures.table)]
    rows: list[tuple[str, ...]] = []
    for row in sorted(figures.table, key=lambda row: row.guide):
        values = [spread(row.figures.get(name)) for name in shown]
        seconds, title = cost(figures.cells_of(row.method, row.guide)), figures.methods[row.method].title
        rows.append((row.guide, title, f"{row.cells - row.failed} of {row.cells}", *values, number(seconds)))
    better = {name: info.better for name, info in figures.metrics.items()}
    networks = {name: figures.metrics[name].stand_in for name in shown if figures.metrics[name].stand_in}
    return Table(
        ("guide", "method", "cells", *(titled(name, better) for name in shown), "CPU s per style"),
        tuple(rows),
        notes=(INTERVALS, *(f"{name}: {network} ({STAND_IN})." for name, network in networks.items())),
    )


def listing(figures: Figures) -> Table:
    """Every score of every method in a row of its own."""
    rows = []
    for row in figures.table:
        for name, one in row.figures.items():
            values = [f"{as_number(value):.7g}" for value in (one.mean, one.low, one.high)]
            rows.append((row.method, row.guide, name, *values, str(one.n)))
    return Table(("method", "guide", "figure", "mean", "low", "high", "n"), tuple(rows))


def spread(interval: Interval | None) -> str:
    """A mean with half of its interval; a dash where there is none."""
    if interval is None:
        return "–"
    low, high = as_number(interval.low), as_number(interval.high)
    return number(as_number(interval.mean)) + (f" ± {number((high - low) / 2)}" if high >= low else "")
