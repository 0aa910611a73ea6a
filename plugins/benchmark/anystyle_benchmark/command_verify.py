"""``anystyle benchmark verify``: whether the figures of a table can be made again."""

import argparse
import random
import sys
import tempfile
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.progress import progress_lines
from anystyle.cli.run import FAILED
from anystyle.errors import UserError, unknown
from anystyle_benchmark.results import read_figures
from anystyle_benchmark.track import Inputs
from anystyle_benchmark.verify import Verifier


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark verify``."""
    flags = new_parser(
        "benchmark verify",
        "Make cells of a table again, images and figures, in a fresh folder, and compare every figure of the cell: "
        "equal, equal within rounding, or not, and then what has changed (code, library, weights, input). "
        "Exit status 2 if a figure is another one.",
    )
    add = flags.add_argument
    add("figures", type=Path, help="a folder that `anystyle benchmark judge` judged, or a figures.json alone")
    which = flags.add_mutually_exclusive_group()
    which.add_argument("--cell", metavar="METHOD/SEED/SCENE/STYLE", help="this cell (default: one at random)")
    which.add_argument("--all", action="store_true", help="every cell")
    add("--cheap", action="store_true", help="compare versions and hashes alone; run nothing")
    add("--method", action="append", default=[], metavar="NAME=FILE.toml", help="the spec of a method of your own")
    add("--track", metavar="NAME", help="a track, or a track.toml (default: that of the results)")
    add("--root", type=Path, metavar="DIR", help="where the track's inputs lie (default: beside its file)")
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark verify``."""
    arguments = parse(parser(), args)
    figures = read_figures(arguments.figures)
    inputs = Inputs(arguments.track or figures.track.name, arguments.root)
    done = [cell for cell in figures.cells if cell.status == "done"]
    names = ["/".join(map(str, cell.cell)) for cell in done]
    if arguments.cell is not None and arguments.cell not in names:
        raise UserError(unknown("cell", arguments.cell, names))
    chosen = done if arguments.all else [done[names.index(arguments.cell or random.choice(names))]]
    programs = dict(word.partition("=")[::2] for word in arguments.method)
    results = arguments.figures if arguments.figures.is_dir() else None
    held = 0
    with tempfile.TemporaryDirectory(prefix="anystyle-verify-") as out:
        verifier = Verifier(figures, inputs, Path(out), programs, results)
        for _, group in groupby(chosen, lambda cell: (cell.method, cell.seed, cell.scene, cell.guide)):
            cells = list(group)
            found = map(verifier.cheaply, cells) if arguments.cheap else verifier.again(cells, progress_lines())
            for verification in found:
                held += verification.holds
                print(verification, flush=True)
    print(f"{held} of {len(chosen)} cells hold")
    if held < len(chosen):
        sys.exit(FAILED)
