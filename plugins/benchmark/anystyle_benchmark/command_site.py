"""``anystyle benchmark site``: judged results as a static site."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.progress import progress_lines
from anystyle.errors import UserError
from anystyle_benchmark.judge import inputs_of
from anystyle_benchmark.results import FIGURES, read_figures
from anystyle_benchmark.site import build


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark site``."""
    flags = new_parser(
        "benchmark site",
        "Make a static site of judged results: tables, cost against quality, every cell's pictures side by side. It "
        "opens from its folder and from any server, and loads nothing from other addresses.",
    )
    add = flags.add_argument
    add("results", type=Path, help="the folder that `anystyle benchmark judge` judged")
    add("--out", type=Path, required=True, metavar="DIR", help="the site's folder")
    add("--track", metavar="NAME", help="a track, or a track.toml (default: that of the results)")
    add("--root", type=Path, metavar="DIR", help="where the track's inputs lie (default: beside its file)")
    add(
        "--megabytes",
        type=float,
        default=60,
        metavar="N",
        help="the site's largest size; sets the quality of its pictures (default 60)",
    )
    return flags


def main(words: Sequence[str]) -> None:
    """Run ``anystyle benchmark site``."""
    arguments = parse(parser(), words)
    figures = read_figures(arguments.results)
    inputs = inputs_of(arguments.results, arguments.track, arguments.root)
    if inputs.digest != figures.track.digest:
        raise UserError(
            f"{arguments.results / FIGURES} is of other inputs, or another version of track or judge; run "
            f"`anystyle benchmark judge {arguments.results}`"
        )
    made = build(inputs, arguments.results, figures, arguments.out, arguments.megabytes, progress_lines())
    print(
        f"{arguments.out / 'index.html'}: {made.size / 1e6:.1f} MB, pictures at {made.scale:.0%} of their size in AVIF "
        f"quality {made.quality}"
    )
