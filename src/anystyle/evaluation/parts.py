"""Finished pieces of an evaluation on disk, so that an interrupted one goes on."""

import hashlib
import json
import pickle
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path

import torch

from anystyle.contracts import Metric
from anystyle.evaluation.contract import Evaluation, Progress
from anystyle.evaluation.folders import Cell, Pairing, Reader
from anystyle.evaluation.judge import Judged, SceneFigures, check, gathered, judge_row, merged
from anystyle.files import atomic_path

FOLDER = "parts"
"""Below the folder of an evaluation: ``parts/METRIC-SCENE.json``; what is deleted there is computed again.

While a scene is not finished, ``parts/METRIC-SCENE.rows`` holds what the metric took in of each style.
"""


def judge_pairing(
    metrics: Mapping[str, Metric], pairing: Pairing, out: Path, progress: Progress, *, stage: str = "judge"
) -> Evaluation:
    """The figures of paired images; what each metric says of a scene is kept, and not computed again.

    Args:
        metrics: By name.
        pairing: What is judged.
        out: The folder of the evaluation.
        progress: Told of every scene in one style.
        stage: Its name.

    Raises:
        ValueError: There is no metric, or images cannot be judged.
    """
    if not metrics:
        raise ValueError("no metric is chosen; add metric=[NAME,...] (`anystyle plugins metric` lists them)")
    reader, done, total = Reader(), 0, len(pairing.cells)
    found: dict[str, dict[str, SceneFigures]] = {}
    for scene, cells in pairing.scenes().items():
        seal = _seal(cells)
        kept = {name: read(place_of(out, name, scene), seal) for name in metrics}
        missing = {name: metric for name, metric in metrics.items() if kept[name] is None}
        fresh: dict[str, SceneFigures] = {}
        if missing:
            taken: dict[str, dict[str, Judged]] = {name: {} for name in missing}
            for place, cell in enumerate(cells):
                progress(stage, done + place, total)
                for name, row in _judge(missing, cell, reader, out).items():
                    taken[name][cell.style] = row
            fresh = {name: merged(name, metric, taken[name]) for name, metric in missing.items()}
            for name, figures in fresh.items():
                path = place_of(out, name, scene)
                write(path, seal, figures)
                shutil.rmtree(_rows(path), ignore_errors=True)
        done += len(cells)
        found[scene] = {name: fresh.get(name) or kept[name] for name in metrics}  # pyright: ignore[reportArgumentType]
    progress(stage, total, total)
    judged = gathered(found, n=sum(len(cell.frames) for cell in pairing.cells))
    pictures = {(cell.scene, cell.style): _pictures(cell) for cell in pairing.cells}
    rows = tuple(replace(row, pictures=pictures[row.scene, row.style]) for row in judged.rows)
    return replace(judged, rows=rows)


def _judge(metrics: Mapping[str, Metric], cell: Cell, reader: Reader, out: Path) -> dict[str, Judged]:
    """What metrics say of one scene in one style; images are read only where one has not said it before."""
    mark = hashlib.sha256(cell.style.encode()).hexdigest()[:16]
    places = {name: _rows(place_of(out, name, cell.scene)) / f"{mark}.pt" for name in metrics}
    seal = _seal([cell])
    kept = {name: _read_row(place, seal) for name, place in places.items()}
    found = {name: row for name, row in kept.items() if row is not None}
    if len(found) < len(metrics):
        comparison = reader(cell)
        check(comparison)
        for name, metric in metrics.items():
            if name not in found:
                found[name] = judge_row(name, metric, comparison)
                with atomic_path(places[name]) as temporary:
                    torch.save({"seal": seal, **vars(found[name])}, temporary)
    return found


def _rows(place: Path) -> Path:
    """The folder of what a metric took in of a scene that is not finished."""
    return place.with_suffix(".rows")


def _read_row(path: Path, seal: str) -> Judged | None:
    try:
        stored = torch.load(path, map_location="cpu", weights_only=True)
        return Judged(**stored) if stored.pop("seal") == seal else None
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, EOFError, pickle.UnpicklingError):
        return None  # absent, or of another version: computed again


def _pictures(cell: Cell) -> dict[str, Path]:
    middle = len(cell.frames) // 2
    return {"photograph": cell.content[middle], "style": cell.reference, "result": cell.stylized[middle]}


def forget(out: Path, metrics: Iterable[str]) -> None:
    """Delete what some metrics said, so that they are asked again."""
    for name in metrics:
        for path in (out / FOLDER).glob(f"{name}-*.json"):
            path.unlink()
        for path in (out / FOLDER).glob(f"{name}-*.rows"):
            shutil.rmtree(path)


def place_of(out: Path, metric: str, scene: str) -> Path:
    """Where what a metric said of a scene is kept."""
    # Two scenes may differ in what a file name cannot hold.
    mark = hashlib.sha256(scene.encode()).hexdigest()[:8]
    plain = "".join(letter if letter.isalnum() else "-" for letter in scene)[:40]
    return out / FOLDER / f"{metric}-{plain}-{mark}.json"


def _seal(cells: Iterable[Cell]) -> str:
    """What the figures of a scene depend on: which files, of what size, written when."""
    digest = hashlib.sha256()
    for cell in cells:
        files = [*cell.content, *cell.stylized, cell.reference, *cell.depth, *([cell.cameras] if cell.cameras else [])]
        for path in files:
            state = path.stat()
            digest.update(f"{cell.style}\0{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def write(path: Path, seal: str, figures: SceneFigures) -> None:
    """Keep what a metric said of a scene, sealed by what it depends on."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"seal": seal, **asdict(figures)}, indent=1) + "\n", encoding="utf-8")


def read(path: Path, seal: str) -> SceneFigures | None:
    """What was kept under a seal; ``None`` where there is nothing, or of another seal."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored.pop("seal") != seal:
            return None
        return SceneFigures(**{**stored, "warned": tuple(stored["warned"])})
    except (OSError, ValueError, KeyError, TypeError):
        return None  # absent, or of another version: computed again
