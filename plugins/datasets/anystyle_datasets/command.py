"""The command ``anystyle data``."""

import argparse
import shlex
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from anystyle.cli.arguments import new_parser, parse, subcommand
from anystyle.contracts import Command
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path, write_json
from anystyle_datasets.checking import INDEX, FolderReport, check
from anystyle_datasets.duplicates import same_pictures
from anystyle_datasets.wikiart import pictures_below

SUBCOMMANDS = {"check": "what a folder of scenes or styles holds, and what in it is missing or damaged"}


class Data(Command):
    """Check training data before it is trained on."""

    def __call__(self, words: Sequence[str]) -> None:
        if subcommand("data", self.__doc__, SUBCOMMANDS, words):
            check_command(words[1:])


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle data check``."""
    flags = new_parser("data check", SUBCOMMANDS["check"])
    add = flags.add_argument
    add("path", type=Path, help="a folder")
    layouts = ("scenes", "re10k", "styles", "wikiart")
    add("--as", dest="layout", choices=layouts, help="how to read it (default: recognised)")
    add("--min-views", type=int, default=2, help="views that a scene needs (default: %(default)s)")
    add("--headers", action="store_true", help="do not decode pixels: faster, but misses truncated files")
    add("--index", action="store_true", help=f"write {INDEX}, the list of the scenes that can be used")
    add("--against", type=Path, help="a folder of test styles: name the pictures that are in both")
    add("--write", type=Path, help="with --against: write their names to a file, for styles.exclude=[FILE]")
    return flags


def check_command(words: Sequence[str]) -> None:
    """Run ``anystyle data check``."""
    arguments = parse(parser(), words)
    root: Path = arguments.path
    if arguments.write is not None and arguments.against is None:
        raise UserError("--write FILE needs --against FOLDER, whose pictures it lists")
    if arguments.index and (root / INDEX).is_file():
        raise UserError(f"--index: {root / INDEX} is there already; delete it to list the scenes anew")
    start = time.perf_counter()
    report = check(root, layout=arguments.layout, min_views=arguments.min_views, decode=not arguments.headers)
    print("\n".join(lines(report)))
    if arguments.against is not None:
        _overlap(root, arguments.against, arguments.write)
        if arguments.write is not None and report.layout == "wikiart":
            report.use += " " + shlex.quote(f"styles.exclude=[{arguments.write}]")
    print(f"checked in {time.perf_counter() - start:.1f} s")
    if not report.images or (report.layout in ("scenes", "re10k") and not report.usable):
        raise UserError(f"{root} holds nothing that can be used")
    if arguments.index:
        if not report.unlisted:
            raise UserError(f"--index is for scenes as DL3DV lays them out; {root} needs no list")
        write_json(root / INDEX, report.usable)
        print(f"index     {len(report.usable)} scenes in {root / INDEX}")
    elif report.unlisted:
        print(f"next      {shlex.join(['anystyle', 'data', 'check', *words, '--index'])}")
        return
    print(f"next      anystyle train experiment=paper_head {report.use}")


def lines(report: FolderReport) -> Iterator[str]:
    """A report as lines of a label and a value."""
    scenes = report.layout in ("scenes", "re10k")
    yield f"layout    {report.layout}"
    if scenes:
        counts = sorted(report.views.elements()) or [0]
        each = f"{counts[0]}" if counts[0] == counts[-1] else f"{counts[0]} to {counts[-1]}"
        yield f"scenes    {len(report.usable)} that can be used, of {report.views.total()}, {each} views each"
    yield f"images    {report.images}"
    yield from (f"          {count} of {width} x {height}" for (width, height), count in report.sizes.most_common(5))
    if len(report.sizes) > 5:
        yield f"          and {len(report.sizes) - 5} more sizes"
    if scenes:
        yield f"cameras   {report.posed}" + ("" if report.posed else ": training needs none")
    else:
        yield f"texts     {report.texts}"
    yield f"problems  {len(report.problems)}"
    yield from (f"          {problem}" for problem in report.problems)


def _overlap(root: Path, tests: Path, write: Path | None) -> None:
    train, test = pictures_below(root), pictures_below(tests)
    if not test:
        raise UserError(f"--against {tests}: there are no pictures in it")
    both = same_pictures(train, test)
    print(f"overlap   {len(both)} of {len(test)} pictures of {tests}")
    for path, other in both.items():
        print(f"          {path.relative_to(root)} is {other.relative_to(tests)}")
    if write is not None:
        with atomic_path(write) as temporary:
            temporary.write_text("".join(f"{path.relative_to(root).as_posix()}\n" for path in both), encoding="utf-8")
