"""Tables, plots and a contact sheet of runs: Markdown, CSV, LaTeX and PNG."""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from anystyle.commands._flags import new_parser, parse
from anystyle.commands._run import run, words_of
from anystyle.evaluation import plots, published, report, runs
from anystyle.evaluation.tables import STAND_IN, Table
from anystyle.io.atomic import atomic_directory
from anystyle.io.sheet import contact_sheet

_COLORS = {"ours": plots.OURS, "stand-in": plots.STOOD_IN, "published": plots.PUBLISHED, "none": plots.PUBLISHED}


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle report``."""
    words = new_parser(
        "report",
        "Set runs side by side: evaluations, trainings, the jobs of a multirun. A row for each variant "
        "(runs that differ by seed alone are one), figures in columns; jobs that failed are rows that say so.",
    )
    words.add_argument("folders", nargs="*", type=Path, metavar="DIR", help="a run, a multirun, or a folder of these")
    words.add_argument("--figures", default="", metavar="A,B", help="which figures, in this order (default: all)")
    words.add_argument("--scenes", action="store_true", help="columns for each scene, not their mean")
    words.add_argument("--with-published", action="store_true", help="with rows that papers printed, scene by scene")
    words.add_argument("--published", type=Path, action="append", default=[], metavar="FILE", help="more such rows")
    tables = [*published.tables(), "all"]
    words.add_argument(
        "--paper", action="append", default=[], choices=tables, help="this table of the paper as printed, ours below it"
    )
    words.add_argument("--out", type=Path, help="where the files go (default: DIR/report)")
    return words


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``anystyle report``."""
    arguments = parse(parser(), words_of(argv))
    with_published = arguments.with_published or bool(arguments.published)
    if not arguments.folders and not with_published and not arguments.paper:
        raise ValueError("no folder is named; give a run, a multirun or an evaluation, or --with-published alone")
    items = [item for folder in arguments.folders for item in runs.find(folder)]
    lines, better = report.lines_of(items) if items else ([], {})
    better = {**published.better(), **better}
    out = arguments.out or (arguments.folders[0] / "report" if arguments.folders else Path("report"))
    if arguments.paper:
        return _paper(arguments, lines, better, out)
    figures = published.load(arguments.published) if with_published else []
    more, sources = report.published_lines(figures)
    lines += more
    names = report.figures_of(lines, [name for name in arguments.figures.split(",") if name])
    scenes = report.scenes_of(lines, names) if arguments.scenes or with_published else []
    # What is no scene's has a column of its own.
    whole = [report.ALL] if not scenes or any(_ungrouped(line) for line in lines) else []
    columns = report.columns_of(lines, names, [*whole, *scenes])
    notes = _notes(lines) + sources + report.consistency_notes(figures)
    table = report.table(lines, columns, better, notes=notes)
    with atomic_directory(out) as folder:
        written = write(table, lines, columns, better, folder)
    print(table.markdown(), end="")
    print(f"\nin {out}: {', '.join(written)}")
    return 0


def _paper(arguments: argparse.Namespace, ours: Sequence[report.Line], better: dict[str, str], out: Path) -> int:
    """Print and write the tables of the paper that are named."""
    if arguments.figures or arguments.scenes or arguments.with_published or arguments.published:
        raise ValueError("--paper prints a table as it is; leave out --figures, --scenes and the published rows")
    forms = published.tables()
    figures = published.load()
    written: list[str] = []
    with atomic_directory(out) as folder:
        for name in forms if "all" in arguments.paper else dict.fromkeys(arguments.paper):
            table = report.paper_table(forms[name], figures, ours, better)
            table = replace(table, notes=(*table.notes, *_notes(ours)))
            written += _write_forms(table, folder, name)
            print(table.markdown())
    print(f"in {out}: {', '.join(written)}")
    return 0


def _write_forms(table: Table, out: Path, name: str) -> list[str]:
    """Write a table as Markdown, CSV and LaTeX; return the names of the files."""
    texts = {f"{name}.md": table.markdown(), f"{name}.csv": table.csv(), f"{name}.tex": table.latex()}
    for file, text in texts.items():
        (out / file).write_text(text, encoding="utf-8")
    return list(texts)


def write(
    table: Table, lines: Sequence[report.Line], columns: Sequence[report.Column], better: dict[str, str], out: Path
) -> list[str]:
    """Write all files of a report; return their names."""
    written = _write_forms(table, out, "table")
    sheet = report.sheet_cells(lines)
    if sheet is not None:
        cells, titles, styles = sheet
        contact_sheet(cells, row_titles=titles, column_titles=styles, cell=(160, 160)).save(out / "sheet.png")
        written.append("sheet.png")
    try:
        _plot(lines, columns, better, out / "figures.png")
        written.append("figures.png")
    except ImportError as error:
        print(f"no plot: {error}", file=sys.stderr)
    return written


def _plot(lines: Sequence[report.Line], columns: Sequence[report.Column], better: dict[str, str], path: Path) -> None:
    groups: dict[str, dict[str, float]] = {}
    colors: dict[tuple[str, str], str] = {}
    directions: dict[str, str] = {}
    notes: dict[str, str] = {}
    for line in lines:
        # What stands in is said below the panels, not by rows of its own: a figure of a run is either.
        title = line.title + ("\npublished" if line.origin == "published" else "")
        title += f"\n{line.state}" if line.state else ""
        for scene, name in columns:
            panel = f"{scene} {name}".strip()
            directions |= {panel: better[name]} if name in better else {}
            value = line.value(scene, name)
            value = value if math.isfinite(value) else math.nan  # a table can say what a bar cannot
            group = groups.setdefault(title, {})
            # One method may have rows from several papers.
            group[panel] = group.get(panel, value) if value != value else value
            if value == value:
                colors[title, panel] = _COLORS[line.origin]
                notes |= {panel: STAND_IN} if line.origin == "stand-in" else {}
    panels = list(dict.fromkeys(panel for group in groups.values() for panel, value in group.items() if value == value))
    if panels:
        plots.bars(groups, panels, path, better=directions, colors=colors, notes=notes)


def _ungrouped(line: report.Line) -> bool:
    return bool(line.samples) and all(not scene for scene, _ in line.samples)


def _notes(lines: Sequence[report.Line]) -> list[str]:
    states = [f"{line.title} ({line.state})" for line in lines if line.state]
    notes = [f"{len(states)} of {len(lines)} rows have no figures: {', '.join(states)}."] if states else []
    if any(line.origin == "stand-in" for line in lines):
        notes.append(f"Rows that say “{STAND_IN}” come from networks that stand in for published ones.")
    return notes


if __name__ == "__main__":
    run(main)
