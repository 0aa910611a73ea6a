"""Runs side by side, in the layout of the paper's tables: a row for each variant, columns of figures."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from anystyle.data.folder import natural
from anystyle.data.images import SUFFIXES, open_image
from anystyle.evaluation.published import FROM_PARTS, PublishedFigure, disagreements
from anystyle.evaluation.runs import Run
from anystyle.evaluation.tables import STAND_IN, Table, number, titled
from anystyle.sheet import Cell, TextCard

Origin = Literal["ours", "stand-in", "published", "none"]
ALL = ""
"""The scene of a figure that stands for all scenes."""

_SEED = "seed"
_PREFERRED = ("art_score", "art_fid")
_SCENES = {name.casefold(): name for name in ("Train", "Truck", "M60", "Garden")}


@dataclass(frozen=True)
class Line:
    """One row of the table.

    Args:
        title: What it is.
        origin: Where its figures come from.
        said: The same in words.
        samples: The values of each figure by (scene, name): one a seed.
        state: What to say instead of figures, where there are none.
        runs: The runs behind it.
    """

    title: str
    origin: Origin
    said: str
    samples: Mapping[tuple[str, str], tuple[float, ...]] = field(default_factory=dict)
    state: str = ""
    runs: tuple[Run, ...] = ()

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
        records = [(run, run.record()) for run in members if run.state == "finished"]
        for _, record in records:
            better.update(record.better)
        if not records:
            lines.append(Line(title, "none", "", state=members[0].state, runs=tuple(members)))
            continue
        lost = len(members) - len(records)
        suffix = f" ({lost} of {len(members)} seeds {'/'.join(sorted({run.state for run in members} - {'finished'}))})"
        stood_in = {name for _, record in records for name in record.stand_ins}
        for origin in ("ours", "stand-in"):
            samples: dict[tuple[str, str], tuple[float, ...]] = {}
            for _, record in records:
                for folder, figures in {ALL: record.figures, **record.scenes}.items():
                    scene = _SCENES.get(folder.casefold(), folder)
                    for name, value in figures.items():
                        if (name in stood_in) == (origin == "stand-in"):
                            samples[scene, name] = (*samples.get((scene, name), ()), value)
            if samples:
                said = STAND_IN if origin == "stand-in" else "computed here"
                lines.append(
                    Line(title + (suffix if lost else ""), origin, said, samples, runs=tuple(run for run, _ in records))
                )
    return lines, better


def published_lines(figures: Sequence[PublishedFigure]) -> tuple[list[Line], list[str]]:
    """Rows of published figures, one a method and source, and a note for each source."""
    rows: dict[tuple[str, str], dict[tuple[str, str], tuple[float, ...]]] = {}
    for item in figures:
        if item.figure != FROM_PARTS:
            rows.setdefault((item.method, item.source), {})[item.scene, item.figure] = (item.value,)
    sources = list(dict.fromkeys(source for _, source in rows))
    lines = [
        Line(method, "published", f"published [{sources.index(source) + 1}]", samples)
        for (method, source), samples in rows.items()
    ]
    return lines, [f"[{place}] {source}" for place, source in enumerate(sources, 1)]


def figures_of(lines: Sequence[Line], wanted: Sequence[str] = ()) -> list[str]:
    """The figures to show: those asked for, or all, with the paper's own first.

    Raises:
        ValueError: None of the runs has a figure that is asked for.
    """
    ours = [line for line in lines if line.origin != "published"]
    known = list(dict.fromkeys(name for line in ours or lines for _, name in line.samples))
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise ValueError(f"no run has the figure {unknown[0]!r}; there are {', '.join(known) or 'none'}")
    if wanted:
        return list(wanted)
    # A protocol may tell figures of texts from those of images: `art_fid_text` is one of `art_fid`.
    first = [name for start in _PREFERRED for name in known if name == start or name.startswith(f"{start}_")]
    return first + [name for name in known if name not in first]


def scenes_of(lines: Sequence[Line], names: Sequence[str]) -> list[str]:
    """The scenes that any row has one of the figures of."""
    return list(dict.fromkeys(scene for line in lines for scene, name in line.samples if scene and name in names))


def table(
    lines: Sequence[Line],
    names: Sequence[str],
    scenes: Sequence[str],
    better: Mapping[str, str],
    *,
    caption: str = "",
    notes: Sequence[str] = (),
) -> Table:
    """A row for each line; columns of figures, each for each scene (or for all of them together)."""
    places = [(scene, name) for scene in scenes for name in names]
    places = [place for place in places if any(place in line.samples for line in lines)] or places
    titles = [f"{scene} {titled(name, better)}".strip() for scene, name in places]
    rows: list[tuple[str, ...]] = []
    for line in lines:
        if line.origin == "published" and not any(place in line.samples for place in places):
            continue
        cells = [line.state or _written(line, place) for place in places]
        rows.append((line.title, line.said or line.state, *cells))
    seeds = max((len(values) for line in lines for values in line.samples.values()), default=1)
    more = [f"± is half the width of the 95 % t interval of the mean over {seeds} seeds."] if seeds > 1 else []
    return Table(("variant", "source", *titles), tuple(rows), caption, (*notes, *more))


def consistency_notes(figures: Sequence[PublishedFigure]) -> list[str]:
    """A line for each published method whose ArtFID does not agree with its own parts."""
    by_method: dict[str, list[str]] = {}
    for item in disagreements(figures):
        by_method.setdefault(item.method, []).append(f"{item.scene} {item.printed:g}, not {item.recomputed:g}")
    return [
        f"{method}: printed ArtFID does not equal (1 + LPIPS)(1 + FID) of its own row: {'; '.join(found)}."
        for method, found in by_method.items()
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
        found = _stylized(line)
        rows.append([_opened(found[name]) if name in found else TextCard(line.state or "no picture") for name in names])
    return rows, ["style", *shown], [f"style {name}" for name in names]


def _title(run: Run, common: set[str]) -> str:
    words = [word for word in run.words if word not in common and word.partition("=")[0].lstrip("+") != _SEED]
    if not words:
        return run.folder.resolve().name if not run.words or len(common) == 0 else " ".join(_short(run.words))
    return " ".join(_short(words))


def _short(words: Sequence[str]) -> list[str]:
    kept = [word for word in words if word.partition("=")[0] != _SEED]
    # One word that differs needs no name in front of its value: `ablation=base` is `base`.
    return [kept[0].partition("=")[2] or kept[0]] if len(kept) == 1 else kept


def _written(line: Line, place: tuple[str, str]) -> str:
    values = [value for value in line.samples.get(place, ()) if not math.isnan(value)]
    if len(values) < 2:
        return number(values[0] if values else None)
    return f"{number(line.value(*place))} ± {number(half_width(values))}"


def half_width(values: Sequence[float]) -> float:
    """Half the width of the 95 % interval of a mean, by Student's t."""
    from scipy import stats

    count = len(values)
    middle = math.fsum(values) / count
    deviation = math.sqrt(math.fsum((value - middle) ** 2 for value in values) / (count - 1))
    return float(stats.t.ppf(0.975, count - 1)) * deviation / math.sqrt(count)


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
