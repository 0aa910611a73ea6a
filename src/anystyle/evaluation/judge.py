"""The metric loop: scores of each scene in each style, of each scene, and over all scenes."""

import logging
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain, count
from typing import Any

import torch

from anystyle.contracts import Metric
from anystyle.contracts.protocol import SCENE, Evaluation, Row
from anystyle.errors import UserError
from anystyle.evaluation.comparisons import Reader
from anystyle.evaluation.pairing import Pairing, StylizedImages
from anystyle.paths import natural
from anystyle.types import Comparison, OnProgress, Progress

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SceneScores:
    """The scores of one metric for one scene: over all styles and of each, with the metric's warnings."""

    scores: Mapping[str, float]
    styles: Mapping[str, Mapping[str, float]]
    better: Mapping[str, str] = field(default_factory=dict)
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    warned: tuple[str, ...] = ()


def judge(metrics: Mapping[str, Metric], comparisons: Iterable[Comparison]) -> Evaluation:
    """The scores of metrics over comparisons of one scene in one style each.

    Over several scenes a score is the mean of the scenes' scores, as published tables have one for each scene.

    Args:
        metrics: By name; they are reset.
        comparisons: Each with one scene, and with its name and that of its style.
    """
    by_scene: dict[str, list[Comparison]] = {}
    for comparison in comparisons:
        by_scene.setdefault(comparison.scenes[0] if comparison.scenes else "", []).append(comparison)
    n = sum(comparison.stylized.shape[1] for rows in by_scene.values() for comparison in rows)
    return aggregate({scene: judge_scene(metrics, rows) for scene, rows in by_scene.items()}, n=n)


def judge_pairing(
    metrics: Mapping[str, Metric], pairing: Pairing, on_progress: OnProgress, *, stage: str = "judge"
) -> Evaluation:
    """The scores of paired image files."""
    if not metrics:
        raise UserError("no metric is chosen; add metric=[NAME,...] (`anystyle plugins metric` lists them)")
    reader, steps, total = Reader(), count(), len(pairing.cells)

    def comparisons(cells: Iterable[StylizedImages]) -> Iterator[Comparison]:
        for cell in cells:
            on_progress(Progress.count(stage, next(steps), total))
            yield reader(cell)

    told = [pairing.lacking()]
    by_scene: dict[str, list[StylizedImages]] = {}
    for cell in pairing.cells:
        by_scene.setdefault(cell.scene, []).append(cell)
    scenes = {scene: judge_scene(metrics, comparisons(cells)) for scene, cells in by_scene.items()}
    on_progress(Progress.count(stage, total, total))
    line = "{} {} are transparent in places and judged on white, such as {}".format
    told += [line(len(some), kind, min(some)) for kind, some in reader.transparent.items() if some]
    for line in filter(None, told):
        log.warning("%s", line)
    evaluation = aggregate(scenes, n=sum(len(cell.frames) for cell in pairing.cells))
    rows = {(row.scene, row.style): row for row in evaluation.rows}
    for cell in pairing.cells:
        key = cell.scene, cell.style
        rows[key] = replace(rows[key], pictures=cell.pictures(), n=len(cell.frames))
    for scene, style, frames, _ in pairing.missing:
        rows[scene, style] = replace(rows.get((scene, style)) or Row(scene, style, {}, n=0), missing=len(frames))
    ordered = sorted(rows.values(), key=lambda row: [natural(row.scene), natural(row.style)])
    gaps = ({"scene": row.scene, "style": row.style, "n": row.n, "missing": row.missing} for row in ordered)
    return replace(evaluation, rows=tuple(ordered)).with_facts(
        missing=[gap for gap in gaps if gap["missing"]],
        warnings=[*filter(None, told), *evaluation.provenance["warnings"]],
    )


def raised(_name: str, error: Exception) -> None:
    """Raise the error of a metric."""
    raise error


@torch.no_grad()
def judge_scene(
    metrics: Mapping[str, Metric],
    comparisons: Iterable[Comparison],
    on_error: Callable[[str, Exception], None] = raised,
) -> dict[str, SceneScores]:
    """The scores of each metric for a scene, given in one style each.

    A metric is updated once with each comparison; the scene's scores are computed from the merged states.

    Args:
        metrics: By name; they are reset.
        comparisons: Each of this scene in one style, with the style's name.
        on_error: Called with the name of a metric that raises a ValueError, and the error; the metric has no scores
            then, and the others have theirs. By default the error is raised.
    """
    metrics = dict(metrics)
    # `Metric.forward` mixes the warnings of `update` with those of a style's scores, copies all states each time and
    # enables gradients.
    styles: dict[str, dict[str, dict[str, float]]] = {name: {} for name in metrics}
    warned: dict[str, list[str]] = {name: [] for name in metrics}
    states: dict[str, dict[str, Any]] = {}
    for index, comparison in enumerate(comparisons):
        style = comparison.styles[0] if comparison.styles else f"{index:02d}"
        for name, metric in [*metrics.items()]:
            metric.compute_with_cache = False  # a scene of one style says its warnings below, where a style's are not
            metric.reset()
            try:
                with _recorded_warnings(warned[name], name):
                    metric.update(comparison.to(metric.device))
                with warnings.catch_warnings(action="ignore"):
                    # Too few images matter for the scene alone, which warns below.
                    styles[name][style] = _compute(metric)
            except ValueError as error:
                on_error(name, error)
                del metrics[name]
                continue
            if name in states:
                metric._update_count = index + 1  # the weight of states that are means
                metric.merge_state(states[name])
            # `reset` empties lists in place.
            states[name] = {
                key: [*value] if isinstance(value, list) else value for key, value in metric.metric_state.items()
            }
    scene: dict[str, SceneScores] = {}
    for name, metric in metrics.items():
        try:
            with _recorded_warnings(warned[name], name):
                scores = _compute(metric)
        except ValueError as error:
            on_error(name, error)
            continue
        for score, values in metric.of_each_row().items():
            for row, value in zip(styles[name].values(), values.tolist(), strict=True):
                row[score] = value
        metric.reset()
        better, stand_ins = dict(metric.better), dict(metric.stand_ins)
        scene[name] = SceneScores(scores, styles[name], better, stand_ins, tuple(warned[name]))
    return scene


def aggregate(scenes: Mapping[str, Mapping[str, SceneScores]], *, n: int) -> Evaluation:
    """The scores over all scenes, from those of each metric for each; ``n`` is the number of stylized images."""
    if not scenes:
        raise UserError("there is nothing to judge; give at least one stylized image with its photograph")
    results = [scores for metrics in scenes.values() for scores in metrics.values()]
    warned = [text for result in results for text in result.warned]
    by_scene: dict[str, dict[str, float]] = {scene: {} for scene in scenes}
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for scene, metrics in scenes.items():
        for result in metrics.values():
            by_scene[scene].update(result.scores)
            for style, scores in result.styles.items():
                rows.setdefault((scene, style), {}).update(scores)
    means: dict[str, float] = {}
    for name in dict.fromkeys(chain.from_iterable(by_scene.values())):
        values = {scene: scores.get(name, math.nan) for scene, scores in by_scene.items()}
        means[name] = mean(list(values.values()))
        few = [scene for scene, value in values.items() if math.isnan(value)]
        if 0 < len(few) < len(scenes):
            warned.append(f"{name} is the mean over the scenes without {', '.join(few)}, which have too little for it")
    return Evaluation(
        scores=means,
        n=n,
        better={name: better for result in results for name, better in result.better.items()},
        groups={f"{SCENE}{scene}": scores for scene, scores in by_scene.items()} if len(scenes) > 1 else {},
        rows=tuple(Row(scene, style, scores) for (scene, style), scores in rows.items()),
        stand_ins={name: network for result in results for name, network in result.stand_ins.items()},
        provenance={"scenes": list(scenes), "warnings": list(dict.fromkeys(warned))},
    )


def mean(values: Sequence[float]) -> float:
    """The mean of the values that are not ``nan``; ``nan`` if none is."""
    known = [value for value in values if not math.isnan(value)]
    return math.fsum(known) / len(known) if known else math.nan


@contextmanager
def _recorded_warnings(texts: list[str], metric: str) -> Iterator[None]:
    """Collect warnings, once each, and log them instead of showing them."""
    with warnings.catch_warnings(record=True, action="always") as caught:
        yield
    for warning in caught:
        text = " ".join(str(warning.message).split())
        if text not in texts:
            texts.append(text)
            log.info("metric %s: %s", metric, text)


def _compute(metric: Metric) -> dict[str, float]:
    return {name: float(value) for name, value in metric.scores().items()}
