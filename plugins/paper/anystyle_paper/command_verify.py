"""Make scores of a table again, and compare them and what they rest on."""

import argparse
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.progress import progress_lines
from anystyle.cli.run import FAILED
from anystyle.errors import UserError
from anystyle_paper import run_table, runs, verify


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle report verify``."""
    flags = new_parser(
        "report verify",
        "Make the evaluations behind a row of a table again, in a fresh folder, and compare every score: equal, "
        "equal within rounding, or not, and then what has changed (code, library, plugin, weights, input). "
        "A training is not repeated: its weights are judged again. Exit status 2 if a score is another one.",
    )
    flags.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="as for anystyle report")
    which = flags.add_mutually_exclusive_group()
    which.add_argument("--row", metavar="ROW", help="this row (default: one at random)")
    which.add_argument("--all", action="store_true", help="every evaluation")
    flags.add_argument("--cheap", action="store_true", help="compare versions and hashes alone; compute nothing")
    flags.add_argument("--out", type=Path, help="keep the evaluations that are made here")
    return flags


def main(words: Sequence[str]) -> int:
    """Run ``anystyle report verify``; returns the exit status."""
    arguments = parse(parser(), words)
    items = [item for folder in arguments.folders for item in runs.find(folder)]
    lines, _ = run_table.lines_of(items)
    if not any(item.evaluation for item in items):
        raise UserError("there are no evaluations, only trainings; judge them with anystyle evaluate --run")
    chosen = items if arguments.all else verify.row_of(lines, arguments.row).runs
    folders = list(dict.fromkeys(each.evaluation for each in chosen if each.evaluation))
    without = list(dict.fromkeys(str(each.folder) for each in chosen if not each.evaluation))
    if without:
        print(f"without an evaluation, and not verified: {', '.join(without)}", file=sys.stderr)
    if arguments.out is not None and arguments.out.exists():
        raise UserError(f"{arguments.out} exists; scores are made again in a folder that does not")
    out = arguments.out or Path(tempfile.mkdtemp(prefix="anystyle-verify-"))
    checked: list[verify.Verification] = []
    try:
        for number, folder in enumerate(folders):
            if arguments.cheap:
                checked.append(verify.cheaply(folder))
            else:
                checked.append(verify.again(folder, out / str(number), progress_lines()))
            print(checked[-1], flush=True)
    finally:
        if arguments.out is None:
            shutil.rmtree(out)
    held = sum(each.holds for each in checked)
    print(f"{held} of {len(checked)} evaluations hold")
    return 0 if held == len(checked) else FAILED
