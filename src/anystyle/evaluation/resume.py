"""Figures of finished scenes and styles on disk, with which an interrupted evaluation goes on."""

import hashlib
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal

import msgspec
import torch

from anystyle.contracts import Metric
from anystyle.documents import Figure, as_number, kept_json
from anystyle.evaluation.contract import Evaluation, Progress
from anystyle.evaluation.folders import Cell, Pairing, Reader
from anystyle.evaluation.runner import RowFigures, SceneFigures, aggregate, judge_row, merge_rows
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import atomic_path, write_json
from anystyle.perception.preprocess import checked

FOLDER = "parts"
"""Below the folder of an evaluation: ``parts/METRIC-SCENE.json``; what is deleted there is computed again.

While a scene is not finished, ``parts/METRIC-SCENE.rows`` holds the state of the metric for each style.
"""


def judge_pairing(
    metrics: Mapping[str, Metric], pairing: Pairing, out: Path, progress: Progress, *, stage: str = "judge"
) -> Evaluation:
    """The figures of paired images; those of each metric for a scene are written down and not computed again.

    Raises:
        ValueError: There is no metric, or images cannot be judged.
    """
    if not metrics:
        raise ValueError("no metric is chosen; add metric=[NAME,...] (`anystyle plugins metric` lists them)")
    reader, done, total = Reader(), 0, len(pairing.cells)
    scenes: dict[str, dict[str, SceneFigures]] = {}
    for scene, cells in pairing.scenes().items():
        digest = _digest(cells)
        stored = {name: read_figures(figures_file(out, name, scene), digest) for name in metrics}
        missing = {name: metric for name, metric in metrics.items() if stored[name] is None}
        rows: dict[str, dict[str, RowFigures]] = {name: {} for name in missing}
        for index, cell in enumerate(cells if missing else ()):
            progress(stage, done + index, total)
            for name, row in _judge_cell(missing, cell, reader, out).items():
                rows[name][cell.style] = row
        scenes[scene] = {name: figures for name, figures in stored.items() if figures is not None}
        for name, metric in missing.items():
            file = figures_file(out, name, scene)
            scenes[scene][name] = merge_rows(name, metric, rows[name])
            write_figures(file, digest, scenes[scene][name])
            shutil.rmtree(_rows_folder(file), ignore_errors=True)
        scenes[scene] = {name: scenes[scene][name] for name in metrics}
        done += len(cells)
    progress(stage, total, total)
    evaluation = aggregate(scenes, n=sum(len(cell.frames) for cell in pairing.cells))
    pictures = {(cell.scene, cell.style): _pictures(cell) for cell in pairing.cells}
    return replace(
        evaluation, rows=tuple(replace(row, pictures=pictures[row.scene, row.style]) for row in evaluation.rows)
    )


def _judge_cell(metrics: Mapping[str, Metric], cell: Cell, reader: Reader, out: Path) -> dict[str, RowFigures]:
    """The figures of metrics for one scene in one style; its images are read only if one is not on disk."""
    name_hash = hashlib.sha256(cell.style.encode()).hexdigest()[:16]
    files = {name: _rows_folder(figures_file(out, name, cell.scene)) / f"{name_hash}.pt" for name in metrics}
    digest = _digest([cell])
    rows = {name: row for name, file in files.items() if (row := _read_row(file, digest)) is not None}
    if len(rows) < len(metrics):
        comparison = checked(reader(cell))
        for name in [name for name in metrics if name not in rows]:
            rows[name] = judge_row(name, metrics[name], comparison)
            with atomic_path(files[name], sync=True) as temporary:
                torch.save({"digest": digest, **vars(rows[name])}, temporary)
    return rows


def _rows_folder(file: Path) -> Path:
    """The folder of a metric's states of a scene that is not finished."""
    return file.with_suffix(".rows")


def _read_row(path: Path, digest: str) -> RowFigures | None:
    try:
        stored = read_tensors(path)
        return RowFigures(**stored) if stored.pop("digest") == digest else None
    except (ValueError, AttributeError, KeyError, TypeError):
        return None  # absent, or of another version: computed again


def _pictures(cell: Cell) -> dict[str, Path]:
    middle = len(cell.frames) // 2
    return {"photograph": cell.content[middle], "style": cell.reference, "result": cell.stylized[middle]}


def forget(out: Path, metrics: Iterable[str]) -> None:
    """Delete the figures of these metrics, so that they are computed again."""
    for name in metrics:
        for file in (out / FOLDER).glob(f"{name}-*.json"):
            file.unlink()
        for folder in (out / FOLDER).glob(f"{name}-*.rows"):
            shutil.rmtree(folder)


def figures_file(out: Path, metric: str, scene: str) -> Path:
    """The file of a metric's figures for a scene."""
    # Two scenes may differ in characters that a file name cannot hold.
    name_hash = hashlib.sha256(scene.encode()).hexdigest()[:8]
    plain = "".join(letter if letter.isalnum() else "-" for letter in scene)[:40]
    return out / FOLDER / f"{metric}-{plain}-{name_hash}.json"


def _digest(cells: Iterable[Cell]) -> str:
    """A hash of what the figures of cells depend on: the files' paths, sizes and times."""
    digest = hashlib.sha256()
    for cell in cells:
        files = [*cell.content, *cell.stylized, cell.reference, *cell.depth, *([cell.cameras] if cell.cameras else [])]
        for path in files:
            state = path.stat()
            digest.update(f"{cell.style}\0{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}\n".encode())
    return digest.hexdigest()


class _Stored(msgspec.Struct):
    """The figures of a metric for a scene as they lie on disk."""

    digest: str
    figures: dict[str, Figure]
    styles: dict[str, dict[str, Figure]]
    better: dict[str, Literal["higher", "lower"]]
    stand_ins: dict[str, str]
    warned: tuple[str, ...]


def write_figures(path: Path, digest: str, figures: SceneFigures) -> None:
    """Write a metric's figures for a scene, with a hash of what they depend on."""
    write_json(path, {"digest": digest, **asdict(figures)})


def read_figures(path: Path, digest: str) -> SceneFigures | None:
    """The figures that were written with this hash; ``None`` where there are none, or with another."""
    stored: _Stored | None = kept_json(path, _Stored)
    if stored is None or stored.digest != digest:
        return None
    return SceneFigures(
        {name: as_number(value) for name, value in stored.figures.items()},
        {style: {name: as_number(value) for name, value in row.items()} for style, row in stored.styles.items()},
        stored.better,
        stored.stand_ins,
        stored.warned,
    )
