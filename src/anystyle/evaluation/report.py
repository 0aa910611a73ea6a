"""Runs side by side, in the layout of the paper's tables: a row for each variant, columns of figures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from anystyle.data.images import SUFFIXES, open_image
from anystyle.evaluation.contract import Evaluation
from anystyle.evaluation.published import PublishedFigure, PublishedTable, disagreements
from anystyle.evaluation.runs import Run
from anystyle.evaluation.tables import STAND_IN, Table, number, titled
from anystyle.io.names import natural
from anystyle.io.sheet import Cell, TextCard

Origin = Literal["ours", "stand-in", "published", "none"]
Column = tuple[str, str]
"""A scene and the name of a figure."""

ALL = ""
"""The scene of a figure that stands for all scenes."""

_SEED = "seed"
_PREFERRED = ("art_score", "art_fid")
_SCENES = {name.casefold(): name for name in ("Train", "Truck", "M60", "Garden")}


@dataclass(frozen=True)
class Line:
    """One row of the table.

    Args:
        title: Of the variant or the published method.
        origin: Of its figures.
        source: The origin in words.
        samples: The values of each figure by (scene, name): one for each seed.
        state: Written instead of figures, where there are none.
        runs: The runs behind it.
        printed: The text of a figure that is shown as it was printed.
    """

    title: str
    origin: Origin
    source: str
    samples: Mapping[Column, tuple[float, ...]] = field(default_factory=dict)
    state: str = ""
    runs: tuple[Run, ...] = ()
    printed: Mapping[Column, str] = field(default_factory=dict)

    def value(self, scene: str, name: str) -> float:
        """The mean over seeds; ``nan`` where there is no figure."""
        values = [value for value in self.samples.get((scene, name), ()) if not math.isnan(value)]
        return math.fsum(values) / len(values) if values else math.nan


def lines_of(runs: Sequence[Run]) -> tuple[list[Line], dict[str, str]]:
    """Rows of runs: those that differ by the seed alone are one; figures of stand-in networks are a row of their own.

    Returns:
        The rows, and ``higher`` or ``lower`` for the figures that say so.
    """
    common = set.intersection(*(set(run.words) for run in runs)) if len(runs) > 1 else set()
    grouped: dict[str, list[Run]] = {}
    for run in runs:
        grouped.setdefault(_title(run, common), []).append(run)
    lines: list[Line] = []
    better: dict[str, str] = {}
    for title, members in grouped.items():
        finished = tuple(run for run in members if run.state == "finished")
        records = [run.record() for run in finished]
        for record in records:
            better.update(record.better)
        if not records:
            lines.append(Line(title, "none", "", state=members[0].state, runs=tuple(members)))
            continue
        states = "/".join(sorted({run.state for run in members} - {"finished"}))
        suffix = f" ({len(members) - len(records)} of {len(members)} seeds {states})" if states else ""
        samples = _samples(records)
        stand_ins = {name for record in records for name in record.stand_ins}
        ours = {key: values for key, values in samples.items() if key[1] not in stand_ins}
        theirs = {key: values for key, values in samples.items() if key[1] in stand_ins}
        if ours:
            lines.append(Line(title + suffix, "ours", "computed here", ours, runs=finished))
        if theirs:
            lines.append(Line(title + suffix, "stand-in", STAND_IN, theirs, runs=finished))
    return lines, better


def _samples(records: Sequence[Evaluation]) -> dict[tuple[str, str], tuple[float, ...]]:
    """The values of every figure in all records, by (scene, name)."""
    samples: dict[tuple[str, str], tuple[float, ...]] = {}
    for record in records:
        for folder, figures in {ALL: record.figures, **record.scenes}.items():
            scene = _SCENES.get(folder.casefold(), folder)
            for name, value in figures.items():
                samples[scene, name] = (*samples.get((scene, name), ()), value)
    return samples


def published_lines(figures: Sequence[PublishedFigure]) -> tuple[list[Line], list[str]]:
    """Rows of published figures, one a method and source, and a note for each source."""
    rows: dict[tuple[str, str], list[PublishedFigure]] = {}
    for item in figures:
        rows.setdefault((item.known_as or item.method, item.source), []).append(item)
    sources = list(dict.fromkeys(source for _, source in rows))
    lines = [
        _published_line(method, f"published [{sources.index(source) + 1}]", items)
        for (method, source), items in rows.items()
    ]
    return lines, [f"[{number}] {source}" for number, source in enumerate(sources, 1)]


def paper_table(
    form: PublishedTable, figures: Sequence[PublishedFigure], ours: Sequence[Line], better: Mapping[str, str]
) -> Table:
    """A table of the paper as it is printed, our rows below it, with what does not add up in its notes.

    Args:
        form: Of the table.
        figures: Of all tables: an ArtFID is recomputed from parts that another table has.
        ours: Rows of runs.
        better: ``higher`` or ``lower`` by figure.
    """
    paper = [item for item in figures if item.source == form.source]
    cells: dict[str, list[PublishedFigure]] = {}
    for item in paper:
        if item.table == form.name:
            cells.setdefault(item.method, []).append(item)
    theirs = [_published_line(method, items[0].origin or "published", items) for method, items in cells.items()]
    lines = [*theirs, *ours]
    columns = columns_of(lines, form.figures, form.scenes)
    shown = {(item.known_as, item.scene) for items in cells.values() for item in items}
    parts = [item for item in paper if (item.known_as, item.scene) in shown]
    notes = [*form.notes, *(consistency_notes(parts) if "art_fid" in form.figures else [])]
    return table(lines, columns, better, caption=f"{form.title} ({form.source}, {form.name})", notes=notes)


def _published_line(title: str, source: str, items: Sequence[PublishedFigure]) -> Line:
    samples: dict[Column, tuple[float, ...]] = {}
    printed: dict[Column, str] = {}
    for item in items:
        # A paper repeats rows in a later table, where it marks nothing.
        samples.setdefault((item.scene, item.figure), (item.value,))
        printed.setdefault((item.scene, item.figure), f"{item.printed} ({item.mark})" if item.mark else item.printed)
    return Line(title, "published", source, samples, printed=printed)


def figures_of(lines: Sequence[Line], requested: Sequence[str] = ()) -> list[str]:
    """The names of the figures to show: the requested ones, or all, with the paper's own first.

    Raises:
        ValueError: None of the runs has a requested figure.
    """
    ours = [line for line in lines if line.origin != "published"]
    known = list(dict.fromkeys(name for line in ours or lines for _, name in line.samples))
    unknown = [name for name in requested if name not in known]
    if unknown:
        raise ValueError(f"no run has the figure {unknown[0]!r}; there are {', '.join(known) or 'none'}")
    if requested:
        return list(requested)
    # A protocol may have a figure for each guide: `art_fid_text` is one of `art_fid`.
    first = [name for prefix in _PREFERRED for name in known if name == prefix or name.startswith(f"{prefix}_")]
    return first + [name for name in known if name not in first]


def scenes_of(lines: Sequence[Line], names: Sequence[str]) -> list[str]:
    """The scenes for which any row has one of these figures."""
    return list(dict.fromkeys(scene for line in lines for scene, name in line.samples if scene and name in names))


def columns_of(lines: Sequence[Line], names: Sequence[str], scenes: Sequence[str]) -> list[Column]:
    """The figures of each scene for which any row has a value, then those that exist over all scenes alone."""
    known = {column for line in lines for column in line.samples}
    columns = [(scene, name) for scene in scenes for name in names]
    columns = [column for column in columns if column in known] or columns
    shown = {name for scene, name in columns if scene != ALL}
    return columns + [
        (ALL, name) for name in names if name not in shown and (ALL, name) in known and (ALL, name) not in columns
    ]


def table(
    lines: Sequence[Line],
    columns: Sequence[Column],
    better: Mapping[str, str],
    *,
    caption: str = "",
    notes: Sequence[str] = (),
) -> Table:
    """A row for each line and a column for each figure of a scene, or of all scenes together."""
    titles = [f"{scene} {titled(name, better)}".strip() for scene, name in columns]
    rows: list[tuple[str, ...]] = []
    for line in lines:
        if line.origin == "published" and not any(column in line.samples for column in columns):
            continue
        cells = [line.state or _cell(line, *column) for column in columns]
        rows.append((line.title, line.source or line.state, *cells))
    num_seeds = max((len(values) for line in lines for values in line.samples.values()), default=1)
    more = [f"± is half the width of the 95 % t interval of the mean over {num_seeds} seeds."] if num_seeds > 1 else []
    return Table(("variant", "source", *titles), tuple(rows), caption, (*notes, *more))


def consistency_notes(figures: Sequence[PublishedFigure]) -> list[str]:
    """A line for each published method whose ArtFID does not agree with its own parts."""
    by_method: dict[str, list[str]] = {}
    for item in disagreements(figures):
        by_method.setdefault(item.method, []).append(f"{item.scene} {item.printed:g}, not {item.recomputed:.2f}")
    return [
        f"{method}: printed ArtFID does not equal (1 + LPIPS)(1 + FID) of its own row: {'; '.join(differences)}."
        for method, differences in by_method.items()
    ]


def sheet_cells(lines: Sequence[Line], *, styles: int = 6) -> tuple[list[list[Cell]], list[str], list[str]] | None:
    """Cells of a contact sheet: a row for each variant, a column for each style; ``None`` without any picture.

    Returns:
        Rows of cells, their titles, and the titles of columns.
    """
    shown: dict[str, Line] = {}
    for line in lines:
        if line.origin != "published":
            shown.setdefault(line.title, line)
    pictured = [line for line in shown.values() if _stylized(line)]
    if not pictured:
        return None
    first = _stylized(pictured[0])
    names = list(first)[:styles]
    folder = _images(pictured[0])
    references = {path.stem: path for path in (folder / "style").iterdir()} if folder else {}
    head: list[Cell] = [_opened(references.get(name)) for name in names]
    rows: list[list[Cell]] = [head]
    for line in shown.values():
        files = _stylized(line)
        rows.append([_opened(files[name]) if name in files else TextCard(line.state or "no picture") for name in names])
    return rows, ["style", *shown], [f"style {name}" for name in names]


def _title(run: Run, common: set[str]) -> str:
    words = [word for word in run.words if word not in common and word.partition("=")[0].lstrip("+") != _SEED]
    if not words:
        return run.folder.resolve().name if not run.words or len(common) == 0 else " ".join(_short(run.words))
    return " ".join(_short(words))


def _short(words: Sequence[str]) -> list[str]:
    kept = [word for word in words if word.partition("=")[0] != _SEED]
    # A single word that differs needs no name before its value: `ablation=base` is `base`.
    return [kept[0].partition("=")[2] or kept[0]] if len(kept) == 1 else kept


def _cell(line: Line, scene: str, name: str) -> str:
    if (scene, name) in line.printed:
        return line.printed[scene, name]
    values = [value for value in line.samples.get((scene, name), ()) if not math.isnan(value)]
    if len(values) < 2:
        return number(values[0] if values else None)
    return f"{number(line.value(scene, name))} ± {number(half_width(values))}"


def half_width(values: Sequence[float]) -> float:
    """Half the width of the 95 % interval of a mean, by Student's t."""
    from scipy import stats

    return float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))


def _images(line: Line) -> Path | None:
    for run in line.runs:
        if run.evaluation is not None and (run.evaluation / "images" / "stylized").is_dir():
            return run.evaluation / "images"
    return None


def _stylized(line: Line) -> dict[str, Path]:
    """For each style the middle frame of the first scene."""
    folder = _images(line)
    scenes = sorted((folder / "stylized").iterdir(), key=lambda path: natural(path.name)) if folder else []
    if not scenes:
        return {}
    by_style: dict[str, list[Path]] = {}
    for path in sorted(scenes[0].iterdir(), key=lambda path: natural(path.name)):
        if path.suffix.lower() in SUFFIXES and not path.name.startswith("."):
            by_style.setdefault(path.stem.rpartition("_")[0], []).append(path)
    return {style: paths[len(paths) // 2] for style, paths in by_style.items()}


def _opened(path: Path | None) -> Cell:
    return None if path is None else open_image(path, longest=640)
