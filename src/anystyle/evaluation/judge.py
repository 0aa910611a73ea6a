"""The metric loop: figures of each scene in each style, of each scene, and over all scenes.

The figures of a metric for a finished scene are kept in ``parts/METRIC-SCENE.json`` below the results, and are not
computed again as long as the images are the same.
"""

import hashlib
import logging
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import torch

from anystyle.contracts import Metric
from anystyle.errors import UserError
from anystyle.evaluation.base import SCENE, Evaluation, Progress, Row
from anystyle.evaluation.comparisons import Reader
from anystyle.evaluation.pairing import Cell, Pairing
from anystyle.io.atomic import write_json
from anystyle.io.documents import Figure, as_number, kept_json
from anystyle.types import Comparison
from anystyle.vision.preprocess import checked

log = logging.getLogger(__name__)

PARTS = "parts"


@dataclass(frozen=True)
class SceneFigures:
    """The figures of one metric for one scene: over all styles and of each, with the metric's warnings."""

    figures: Mapping[str, float]
    styles: Mapping[str, Mapping[str, float]]
    better: Mapping[str, str] = field(default_factory=dict)
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    warned: tuple[str, ...] = ()


def judge(metrics: Mapping[str, Metric], comparisons: Iterable[Comparison]) -> Evaluation:
    """The figures of metrics over comparisons of one scene in one style each.

    Over several scenes a figure is the mean of the scenes' figures, as published tables have one for each scene.

    Args:
        metrics: By name; they are reset.
        comparisons: Each with one scene, and with its name and that of its style.

    Raises:
        UserError: There is no comparison, or one cannot be judged.
    """
    by_scene: dict[str, list[Comparison]] = {}
    for comparison in comparisons:
        by_scene.setdefault(comparison.scenes[0] if comparison.scenes else "", []).append(comparison)
    if not by_scene:
        raise UserError("there is nothing to judge; give at least one stylized image with its photograph")
    n = sum(comparison.stylized.shape[1] for rows in by_scene.values() for comparison in rows)
    return aggregate({scene: judge_scene(metrics, rows) for scene, rows in by_scene.items()}, n=n)


def judge_pairing(
    metrics: Mapping[str, Metric], pairing: Pairing, out: Path, progress: Progress, *, stage: str = "judge"
) -> Evaluation:
    """The figures of paired image files; those of a finished scene are read from ``out``."""
    if not metrics:
        raise UserError("no metric is chosen; add metric=[NAME,...] (`anystyle plugins metric` lists them)")
    reader, done, total = Reader(), 0, len(pairing.cells)

    def comparisons(cells: Sequence[Cell], first: int) -> Iterator[Comparison]:
        for index, cell in enumerate(cells, first):
            progress(stage, index, total)
            yield reader(cell)

    scenes: dict[str, dict[str, SceneFigures]] = {}
    for scene, cells in pairing.scenes().items():
        digest = _digest(cells)
        files = {name: figures_file(out, name, scene) for name in metrics}
        figures = {name: read_figures(file, digest) for name, file in files.items()}
        missing = {name: metric for name, metric in metrics.items() if figures[name] is None}
        for name, judged in (judge_scene(missing, comparisons(cells, done)) if missing else {}).items():
            write_figures(files[name], digest, judged)
            figures[name] = judged
        scenes[scene] = {name: known for name, known in figures.items() if known is not None}
        done += len(cells)
    progress(stage, total, total)
    evaluation = aggregate(scenes, n=sum(len(cell.frames) for cell in pairing.cells))
    pictures = {(cell.scene, cell.style): cell.pictures() for cell in pairing.cells}
    rows = (replace(row, pictures=pictures[row.scene, row.style]) for row in evaluation.rows)
    return replace(evaluation, rows=tuple(rows))


@torch.no_grad()
def judge_scene(metrics: Mapping[str, Metric], comparisons: Iterable[Comparison]) -> dict[str, SceneFigures]:
    """The figures of each metric for a scene, given in one style each.

    A metric is updated once with each comparison; the scene's figures are computed from the merged states.
    """
    styles: dict[str, dict[str, Mapping[str, float]]] = {name: {} for name in metrics}
    warned: dict[str, list[str]] = {name: [] for name in metrics}
    states: dict[str, dict[str, Any]] = {}
    for index, comparison in enumerate(map(checked, comparisons)):
        style = comparison.styles[0] if comparison.styles else f"{index:02d}"
        for name, metric in metrics.items():
            metric.compute_with_cache = False  # a style's figure must not be returned for the scene
            metric.reset()
            with _recorded_warnings(warned[name], name):
                metric.update(comparison.to(metric.device))
            with warnings.catch_warnings():
                # Too few images matter for the scene alone, which warns below.
                warnings.simplefilter("ignore")
                styles[name][style] = _compute(metric)
            if name in states:
                metric._update_count = index + 1  # the weight of states that are means
                metric.merge_state(states[name])
            # `reset` empties lists in place.
            states[name] = {
                key: [*value] if isinstance(value, list) else value for key, value in metric.metric_state.items()
            }
    scene: dict[str, SceneFigures] = {}
    for name, metric in metrics.items():
        with _recorded_warnings(warned[name], name):
            figures = _compute(metric)
        metric.reset()
        better, stand_ins = dict(metric.better), dict(metric.stand_ins)
        scene[name] = SceneFigures(figures, styles[name], better, stand_ins, tuple(warned[name]))
    return scene


def aggregate(scenes: Mapping[str, Mapping[str, SceneFigures]], *, n: int) -> Evaluation:
    """The figures over all scenes, from those of each metric for each; ``n`` is the number of stylized images."""
    results = [figures for metrics in scenes.values() for figures in metrics.values()]
    warned = [text for result in results for text in result.warned]
    by_scene: dict[str, dict[str, float]] = {scene: {} for scene in scenes}
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for scene, metrics in scenes.items():
        for result in metrics.values():
            by_scene[scene].update(result.figures)
            for style, figures in result.styles.items():
                rows.setdefault((scene, style), {}).update(figures)
    means: dict[str, float] = {}
    for name in dict.fromkeys(name for figures in by_scene.values() for name in figures):
        values = {scene: figures.get(name, math.nan) for scene, figures in by_scene.items()}
        means[name] = mean(list(values.values()))
        lacking = [scene for scene, value in values.items() if math.isnan(value)]
        if 0 < len(lacking) < len(scenes):
            warned.append(
                f"{name} is the mean over the scenes without {', '.join(lacking)}, which have too little for it"
            )
    return Evaluation(
        figures=means,
        n=n,
        better={name: better for result in results for name, better in result.better.items()},
        groups={f"{SCENE}{scene}": figures for scene, figures in by_scene.items()} if len(scenes) > 1 else {},
        rows=tuple(Row(scene, style, figures) for (scene, style), figures in rows.items()),
        stand_ins={name: network for result in results for name, network in result.stand_ins.items()},
        provenance={"scenes": list(scenes), "warnings": list(dict.fromkeys(warned))},
    )


def mean(values: Sequence[float]) -> float:
    """The mean of the values that are not ``nan``; ``nan`` if none is."""
    known = [value for value in values if not math.isnan(value)]
    return math.fsum(known) / len(known) if known else math.nan


def figures_file(out: Path, metric: str, scene: str) -> Path:
    """The file of a metric's figures for a scene."""
    # Two scenes may differ in characters that a file name cannot hold.
    name_hash = hashlib.sha256(scene.encode()).hexdigest()[:8]
    plain = "".join(letter if letter.isalnum() else "-" for letter in scene)[:40]
    return out / PARTS / f"{metric}-{plain}-{name_hash}.json"


def write_figures(path: Path, digest: str, figures: SceneFigures) -> None:
    """Write a metric's figures for a scene, with a hash of what they depend on."""
    write_json(path, {"digest": digest, **asdict(figures)})


class _Stored(msgspec.Struct):
    digest: str
    figures: dict[str, Figure]
    styles: dict[str, dict[str, Figure]]
    better: dict[str, Literal["higher", "lower"]]
    stand_ins: dict[str, str]
    warned: tuple[str, ...]


def read_figures(path: Path, digest: str) -> SceneFigures | None:
    """The figures that were written with this hash; ``None`` where there are none, or with another."""
    stored: _Stored | None = kept_json(path, _Stored)
    if stored is None or stored.digest != digest:
        return None

    def numbers(row: Mapping[str, Figure]) -> dict[str, float]:
        return {name: as_number(value) for name, value in row.items()}

    by_style = {name: numbers(row) for name, row in stored.styles.items()}
    return SceneFigures(numbers(stored.figures), by_style, stored.better, stored.stand_ins, stored.warned)


def _digest(cells: Iterable[Cell]) -> str:
    """A hash of what the figures of cells depend on: the files' paths, sizes and times."""
    digest = hashlib.sha256()
    for cell in cells:
        for path in (*cell.content, *cell.stylized, cell.reference, *cell.depth, *filter(None, [cell.cameras])):
            state = path.stat()
            digest.update(f"{cell.style}\0{path.resolve()}\0{state.st_size}\0{state.st_mtime_ns}\n".encode())
    return digest.hexdigest()


@contextmanager
def _recorded_warnings(texts: list[str], metric: str) -> Iterator[None]:
    """Collect warnings, once each, and log them instead of showing them."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        text = " ".join(str(warning.message).split())
        if text not in texts:
            texts.append(text)
            log.info("metric %s: %s", metric, text)


def _compute(metric: Metric) -> dict[str, float]:
    return {name: float(value) for name, value in metric.compute().items()}
