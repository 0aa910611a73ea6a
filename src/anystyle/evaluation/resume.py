"""What lets an interrupted evaluation go on: figures of finished scenes and styles, bound to a configuration."""

import hashlib
import json
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import torch
from omegaconf import DictConfig, OmegaConf

from anystyle.contracts import Metric
from anystyle.documents import Figure, as_number, kept_json, read_json
from anystyle.evaluation.contract import Evaluation, Progress
from anystyle.evaluation.folders import Cell, Pairing, Reader
from anystyle.evaluation.runner import RowFigures, SceneFigures, aggregate, judge_row, merge_rows
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import atomic_path, folder_lock, write_json
from anystyle.perception.preprocess import checked
from anystyle.registry.compose import changes, flat

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


FILE = "bound.json"
_STYLIZER = ("backbone", "style_encoder", "placement", "injector", "renderer", "branch", "seed")


_WHAT = "record of an evaluation; choose another --out, or delete that folder"


class _Bound(msgspec.Struct):
    """What the files of a folder rest on."""

    images: dict[str, Any]
    metrics: dict[str, Any]


@contextmanager
def bind(
    config: DictConfig,
    weights: Mapping[str, Any],
    out: Path,
    parts: Collection[str],
    metric_weights: Mapping[str, Mapping[str, str]],
) -> Iterator[None]:
    """Tie a folder to a configuration, so that all files in it are of the same one, and lock it.

    Metrics may be added and changed; the figures of a changed one are deleted.

    Args:
        config: Of the evaluation.
        weights: What was loaded, with checksums.
        out: The folder.
        parts: The parts that the protocol takes; the configuration of others is ignored.
        metric_weights: For each metric, the weights that it rests on, with checksums.

    Raises:
        ValueError: The folder holds an evaluation of another configuration, or another process is at work there.
    """
    names = ["protocol", *(name for name in ("scenes", "styles") if name in parts)]
    names += _STYLIZER if "stylizer" in parts else ()
    names += ("method", "loss") if "method" in parts else ()
    plain = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(plain, dict)
    images = {name: plain.get(name) for name in names}
    images["weights"] = {part: row["sha256"] for part, row in weights.items()}
    nodes = plain.get("metric") or {}
    metrics = {
        name: [nodes.get(name), plain.get("correspondence"), dict(files)] for name, files in metric_weights.items()
    }
    current = json.loads(json.dumps({"images": images, "metrics": metrics}))
    path = out / FILE
    refusal = f"another evaluation is at work in {out}; wait for its end, or give another --out"
    with folder_lock(out, refusal):
        earlier: _Bound = read_json(path, _Bound, what=_WHAT) if path.is_file() else _Bound(**current)
        changed = changes(flat(earlier.images), flat(current["images"]))
        if changed:
            raise ValueError(
                f"{out} holds an evaluation of another configuration ({changed}); choose another --out, or delete that "
                "folder"
            )
        forget(out, [name for name, row in current["metrics"].items() if earlier.metrics.get(name) != row])
        current["metrics"] = {**earlier.metrics, **current["metrics"]}
        new = not path.is_file()
        write_json(path, current)
        try:
            yield
        except BaseException:
            if new and {entry.name for entry in out.iterdir()} <= {FILE, ".lock"}:
                path.unlink()  # nothing is here yet that rests on it
            raise
