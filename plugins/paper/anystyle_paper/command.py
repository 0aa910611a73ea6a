"""The command ``anystyle report``."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from anystyle.cli.arguments import new_parser, parse
from anystyle.contracts import Command
from anystyle.errors import MissingExtra, UserError
from anystyle.io.atomic import atomic_directory
from anystyle.io.sheet import contact_sheet
from anystyle_paper import bars, latex, published_scores, run_table, runs


class Report(Command):
    """Tables, plots and a contact sheet of runs: Markdown, CSV, LaTeX and PNG."""

    def __call__(self, words: Sequence[str]) -> None:
        report(parse(parser(), words))


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle report``."""
    flags = new_parser(
        "report",
        "Set runs side by side: evaluations, trainings, the jobs of a multirun. A row for each variant "
        "(runs that differ by seed alone are one), scores in columns; jobs that failed are marked so in their row.",
    )
    flags.add_argument("folders", nargs="*", type=Path, metavar="DIR", help="a run, a multirun, or a folder of these")
    flags.add_argument("--scores", default="", metavar="A,B", help="which scores, in this order (default: all)")
    flags.add_argument("--scenes", action="store_true", help="columns for each scene, not their mean")
    flags.add_argument("--with-published", action="store_true", help="with rows that papers printed, scene by scene")
    flags.add_argument("--published", type=Path, action="append", default=[], metavar="FILE", help="more such rows")
    flags.add_argument("--out", type=Path, help="where the files go (default: DIR/report)")
    return flags


def report(arguments: argparse.Namespace) -> None:
    """Run ``anystyle report``."""
    if not arguments.folders and not arguments.with_published and not arguments.published:
        raise UserError("no folder is named; give a run, a multirun or an evaluation, or --with-published alone")
    items = [item for folder in arguments.folders for item in runs.find(folder)]
    lines, better = run_table.lines_of(items) if items else ([], {})
    better = {**published_scores.better(), **better}
    out = arguments.out or (arguments.folders[0] / "report" if arguments.folders else Path("report"))
    with atomic_directory(out) as folder:
        written = _side_by_side(arguments, lines, better, folder)
    print(f"\nin {out}: {', '.join(written)}")


def _side_by_side(
    arguments: argparse.Namespace, lines: list[run_table.Line], better: dict[str, str], out: Path
) -> list[str]:
    """Print and write the table, plot and contact sheet of runs; return the names of the files."""
    with_published = arguments.with_published or bool(arguments.published)
    more, sources = run_table.published_lines(published_scores.load(arguments.published) if with_published else [])
    lines = lines + more
    names = run_table.scores_of(lines, [name for name in arguments.scores.split(",") if name])
    scenes = run_table.scenes_of(lines, names) if arguments.scenes or with_published else []
    # Rows without scores of single scenes have columns of their own.
    overall = any(line.samples and not any(scene for scene, _ in line.samples) for line in lines)
    columns = run_table.columns_of(lines, names, [*([run_table.ALL] if overall or not scenes else []), *scenes])
    lines = [line for line in lines if line.state or any(column in line.samples for column in columns)]
    table = run_table.table(lines, columns, better, notes=run_table.state_notes(lines) + sources)
    written = table.write(out, "table")
    (out / "table.csv").write_text(run_table.data(lines, columns).csv(), encoding="utf-8", errors="backslashreplace")
    (out / "table.tex").write_text(latex.aligned(table), encoding="utf-8", errors="backslashreplace")
    if sheet := run_table.sheet_cells(lines):
        cells, row_titles, column_titles = sheet
        pictures = contact_sheet(cells, row_titles=row_titles, column_titles=column_titles, cell=(160, 160))
        pictures.save(out / "sheet.png")
        written.append("sheet.png")
    try:
        if bars.draw(lines, columns, better, out / "scores.png"):
            written.append("scores.png")
    except MissingExtra as error:
        print(f"no plot: {error}", file=sys.stderr)
    print(table.markdown(), end="")
    return written
