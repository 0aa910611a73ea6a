"""Runs side by side, in the layout of the paper's tables: a row for each variant, columns of scores."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from anystyle.data.images import open_image
from anystyle.errors import UserError
from anystyle.evaluation.tables import STAND_IN, Table, number, titled
from anystyle.io.sheet import Cell, TextCard
from anystyle.paths import natural
from anystyle_paper.published_scores import PublishedScore
from anystyle_paper.runs import Run

ColumnKey = tuple[str, str]
"""A scene and the name of a score."""

ALL = ""
"""The scene of a score over all scenes."""

_FIRST = ("art_score", "art_fid")


Origin = Literal["ours", "stand-in", "published", "none"]


@dataclass(frozen=True)
class Line:
    """One row of the table: a variant or a published method.

    ``source`` is the origin in words, ``samples`` the values of each score (one for each seed), ``state`` the text
    instead of scores where there are none, ``printed`` the text of a score that is shown as it was printed.
    """

    title: str
    origin: Origin
    source: str
    samples: Mapping[ColumnKey, tuple[float, ...]] = field(default_factory=dict)
    state: str = ""
    runs: tuple[Run, ...] = ()
    printed: Mapping[ColumnKey, str] = field(default_factory=dict)

    def values(self, column: ColumnKey) -> list[float]:
        """The values of a score that are not ``nan``."""
        return [value for value in self.samples.get(column, ()) if not math.isnan(value)]

    def value(self, scene: str, name: str) -> float:
        """The mean over seeds; ``nan`` where there is no score."""
        values = self.values((scene, name))
        return math.fsum(values) / len(values) if values else math.nan

    def cell(self, column: ColumnKey) -> str:
        """A score as text, with the half-width of its interval where there are several seeds."""
        if column in self.printed:
            return self.printed[column]
        interval = f" ± {number(self.half_width(column))}" if len(self.values(column)) > 1 else ""
        return number(self.value(*column)) + interval

    def half_width(self, column: ColumnKey) -> float:
        """Half the width of the 95 % interval of the mean over seeds, by Student's t."""
        from scipy import stats

        values = self.values(column)
        return float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))


def lines_of(runs: Sequence[Run]) -> tuple[list[Line], dict[str, str]]:
    """Rows of runs, and the better direction of their scores.

    Runs that differ only in the seed are one row; scores of stand-in networks are rows of their own.
    """
    from anystyle_paper.paper_folder import SCENES

    printed = {name.casefold(): name for name in SCENES}
    common = set.intersection(*(set(run.words) for run in runs)) if len(runs) > 1 else set()
    variants: dict[str, list[Run]] = {}
    for run in runs:
        title = _title(run, common)
        if any(_seed(run) == _seed(other) for other in variants.get(title, ())):
            title += f" ({run.folder.name})"  # the same command twice, not two seeds
        variants.setdefault(title, []).append(run)
    lines: list[Line] = []
    better: dict[str, str] = {}
    for title, members in variants.items():
        finished = tuple(run for run in members if run.state == "finished")
        if not finished:
            lines.append(Line(title, "none", "", state=members[0].state, runs=tuple(members)))
            continue
        states = "/".join(sorted({run.state for run in members} - {"finished"}))
        title += f" ({len(members) - len(finished)} of {len(members)} seeds {states})" if states else ""
        samples: dict[ColumnKey, tuple[float, ...]] = {}
        records = [run.record() for run in finished]
        missing = sum(record.missing() for record in records)
        title += f" ({missing} images missing)" if missing else ""
        for record in records:
            better.update(record.better)
            for folder, scores in {ALL: record.scores, **record.scenes}.items():
                scene = printed.get(folder.casefold(), folder)
                for name, value in scores.items():
                    samples[scene, name] = (*samples.get((scene, name), ()), value)
        stand_ins = {name for record in records for name in record.stand_ins}
        sources: dict[Origin, str] = {"ours": "computed here", "stand-in": STAND_IN}
        for origin, source in sources.items():
            own = {key: values for key, values in samples.items() if (key[1] in stand_ins) is (origin == "stand-in")}
            lines += [Line(title, origin, source, own, runs=finished)] if own else []
    return lines, better


def _seed(run: Run) -> list[str]:
    return [word for word in run.words if word.partition("=")[0].lstrip("+") == "seed"]


def _title(run: Run, common: set[str]) -> str:
    """The words of a run that others do not have, without its seed and its folder."""
    words = [word for word in run.words if word.partition("=")[0].lstrip("+") not in ("seed", "out")]
    own = [word for word in words if word not in common]
    if not own and common:  # all runs have the same words
        own = words
    if not own:
        return run.folder.resolve().name
    if len(own) > 1:
        return " ".join(own)
    # A single word needs no name before its value, if that is a name: `ablation=base` is `base`.
    _, _, value = own[0].partition("=")
    return value if re.fullmatch(r"(?i)(?!(null|none|true|false|nan|inf)$)[a-z][\w/-]*", value) else own[0]


def published_lines(scores: Sequence[PublishedScore]) -> tuple[list[Line], list[str]]:
    """Rows of published scores, one for each method and source, and a note for each source."""
    rows: dict[tuple[str, str], list[PublishedScore]] = {}
    for item in scores:
        rows.setdefault((item.known_as, item.source), []).append(item)
    sources = {source: f"[{number}]" for number, source in enumerate(dict.fromkeys(item.source for item in scores), 1)}
    lines = [_published_line(name, f"published {sources[source]}", items) for (name, source), items in rows.items()]
    return lines, [f"{number} {source}" for source, number in sources.items()]


def _published_line(title: str, source: str, items: Sequence[PublishedScore]) -> Line:
    samples: dict[ColumnKey, tuple[float, ...]] = {}
    printed: dict[ColumnKey, str] = {}
    for item in items:
        # A paper repeats rows in a later table, where it marks nothing.
        samples.setdefault((item.scene, item.score), (item.value,))
        printed.setdefault((item.scene, item.score), f"{item.printed} ({item.mark})" if item.mark else item.printed)
    return Line(title, "published", source, samples, printed=printed)


def scores_of(lines: Sequence[Line], requested: Sequence[str] = ()) -> list[str]:
    """The names of the scores to show: the requested ones, or all, with the paper's own first."""
    ours = [line for line in lines if line.origin != "published"]
    known = list(dict.fromkeys(name for line in ours or lines for _, name in line.samples))
    if unknown := [name for name in requested if name not in known]:
        raise UserError(f"no run has the score {unknown[0]!r}; there are {', '.join(known) or 'none'}")
    # A protocol may have a score for each guide: `art_fid_text` is one of `art_fid`.
    first = [name for prefix in _FIRST for name in known if name == prefix or name.startswith(f"{prefix}_")]
    return list(requested) or first + [name for name in known if name not in first]


def scenes_of(lines: Sequence[Line], names: Sequence[str]) -> list[str]:
    """The scenes for which any row has one of these scores."""
    return list(dict.fromkeys(scene for line in lines for scene, name in line.samples if scene and name in names))


def columns_of(lines: Sequence[Line], names: Sequence[str], scenes: Sequence[str]) -> list[ColumnKey]:
    """The scores of each scene for which any row has a value, then those that exist only over all scenes."""
    known = {column for line in lines for column in line.samples}
    columns = [(scene, name) for scene in scenes for name in names]
    columns = [column for column in columns if column in known] or columns
    shown = {name for scene, name in columns if scene != ALL}
    overall = [(ALL, name) for name in names if name not in shown and (ALL, name) in known]
    return columns + [column for column in overall if column not in columns]


def table(
    lines: Sequence[Line], columns: Sequence[ColumnKey], better: Mapping[str, str], *, notes: Sequence[str] = ()
) -> Table:
    """A row for each line and a column for each score of a scene, or of all scenes together."""
    titles = [f"{scene} {titled(name, better)}".strip() for scene, name in columns]
    rows = tuple((line.title, line.source or line.state, *map(line.cell, columns)) for line in lines)
    return Table(("variant", "source", *titles), rows, notes=tuple(notes))


def data(lines: Sequence[Line], columns: Sequence[ColumnKey]) -> Table:
    """The table as numbers in full precision: each score, the half-width of its interval, and ``n``, the seeds.

    Without an interval, as for one seed, its cell is empty.
    """
    titles = [f"{scene} {name}".strip() for scene, name in columns]
    rows: list[tuple[str, ...]] = []
    for line in lines:
        counts, cells = [len(line.values(column)) for column in columns], list[str]()
        for column, count in zip(columns, counts, strict=True):
            cells += [repr(line.value(*column)) if count else "", repr(line.half_width(column)) if count > 1 else ""]
        number = "" if line.origin == "published" else str(max(counts, default=0))
        rows.append((line.title, line.source or line.state, *cells, number))
    names = [name for title in titles for name in (title, f"{title}_half_width")]
    return Table(("variant", "source", *names, "n"), tuple(rows))


def state_notes(lines: Sequence[Line]) -> list[str]:
    """Notes on runs without scores, on stand-ins, and on intervals."""
    states = [f"{line.title} ({line.state})" for line in lines if line.state]
    notes = [f"{len(states)} of {len(lines)} rows have no scores: {', '.join(states)}."] if states else []
    if any(line.origin == "stand-in" for line in lines):
        notes.append(f"Rows marked “{STAND_IN}” come from networks that replace the published ones.")
    numbers = {line.title: run.record().n for line in lines for run in line.runs if line.samples and run.record().n}
    if len({*numbers.values()}) > 1:
        told = ", ".join(f"{title} {n}" for title, n in numbers.items())
        notes.append(f"Behind the rows are different numbers of samples: {told}.")
    notes += version_notes(lines)
    num_seeds = max((len(values) for line in lines for values in line.samples.values()), default=1)
    if num_seeds > 1:
        notes.append(f"± is half the width of the 95 % t interval of the mean over {num_seeds} seeds.")
    return notes


def version_notes(lines: Sequence[Line]) -> list[str]:
    """Whether all evaluations behind the rows were made by one version of the code and its libraries."""
    made: dict[str, list[str]] = {}
    for line in lines:
        for run in line.runs if line.samples else ():
            known = run.record().provenance
            words = [" ".join(pair) for pair in known.get("versions", {}).items()]
            if commit := known.get("commit"):
                words.append(f"commit {commit[:12]}{'+' if commit.endswith('+') else ''}")
            made.setdefault(", ".join(words), []).append(line.title)
    made.pop("", None)  # what a training logged
    if len(made) < 2:
        return [f"All scores computed here are of {version}." for version in made]
    rows = (f"{version}: {', '.join(dict.fromkeys(titles))}" for version, titles in made.items())
    return [f"Rows are of {len(made)} versions. {'; '.join(rows)}."]


def sheet_cells(lines: Sequence[Line], *, num_styles: int = 6) -> tuple[list[list[Cell]], list[str], list[str]] | None:
    """A contact sheet's rows of cells, their titles and those of its columns; ``None`` without any picture.

    It has a row for each variant and a column for each style, with the middle frame of the first scene.
    """
    shown: dict[str, Line] = {}
    for line in lines:
        if line.origin != "published":
            shown.setdefault(line.title, line)
    pictures = {title: _stylized(line) for title, line in shown.items()}
    first = next((files for files in pictures.values() if files), None)
    if first is None:
        return None
    names = list(first)[:num_styles]
    references = {path.stem: path for path in (first[names[0]].parents[2] / "style").iterdir()}
    rows = [(references, ""), *((pictures[title], line.state or "no picture") for title, line in shown.items())]
    cells: list[list[Cell]] = [
        [open_image(files[name], longest=640) if name in files else TextCard(otherwise) for name in names]
        for files, otherwise in rows
    ]
    return cells, ["style", *shown], [f"style {name}" for name in names]


def _stylized(line: Line) -> dict[str, Path]:
    """For each style the middle frame of the first scene, of the first run that has any."""
    from anystyle.data.folder import image_files
    from anystyle_paper.paper_folder import images_by_style

    folders = (run.evaluation / "images" for run in line.runs if run.evaluation)
    scenes = next((found for folder in folders if (found := list(folder.glob("stylized/[!.]*")))), [])
    if not scenes:
        return {}
    scene = min(scenes, key=lambda path: natural(path.name))
    by_style = images_by_style(scene, [path.stem for path in image_files(scene.parents[1] / "style")])
    return {style: [*frames.values()][len(frames) // 2] for style, frames in by_style.items()}
