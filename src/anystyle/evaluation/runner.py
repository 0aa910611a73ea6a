"""Metrics over comparisons: figures of each scene in each style, of each scene, and over all scenes."""

import logging
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.evaluation.contract import SCENE, Evaluation, Row
from anystyle.perception.preprocess import checked
from anystyle.types import Comparison

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SceneFigures:
    """The figures of one metric for one scene.

    Args:
        figures: Over all styles.
        styles: Of each style, in order.
        better: ``higher`` or ``lower`` by figure.
        stand_ins: The stand-in network behind a figure, where there is one.
        warned: The metric's warnings.
    """

    figures: Mapping[str, float]
    styles: Mapping[str, Mapping[str, float]]
    better: Mapping[str, str] = field(default_factory=dict)
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    warned: tuple[str, ...] = ()


@dataclass(frozen=True)
class RowFigures:
    """The figures of one metric for one scene in one style.

    Args:
        figures: Of this comparison alone.
        state: The metric's state after it, as :meth:`torchmetrics.Metric.merge_state` takes it.
        warned: The metric's warnings.
    """

    figures: Mapping[str, float]
    state: Mapping[str, Any]
    warned: tuple[str, ...] = ()


def judge(metrics: Mapping[str, Metric], comparisons: Iterable[Comparison]) -> Evaluation:
    """The figures of metrics over comparisons of one scene in one style each.

    A metric is updated once with each comparison; a scene's figures are computed from the merged states of its styles.
    Over several scenes a figure is the mean of the scenes' figures, as published tables have one for each scene.

    Args:
        metrics: By name; they are reset.
        comparisons: Each with one scene, and with its name and that of its style.

    Raises:
        ValueError: There is no comparison, or one cannot be judged.
    """
    by_scene: dict[str, list[Comparison]] = {}
    for comparison in comparisons:
        by_scene.setdefault(comparison.scenes[0] if comparison.scenes else "", []).append(comparison)
    if not by_scene:
        raise ValueError("there is nothing to judge; give at least one stylized image with its photograph")
    n = sum(comparison.stylized.shape[1] for rows in by_scene.values() for comparison in rows)
    return aggregate({scene: judge_scene(metrics, rows) for scene, rows in by_scene.items()}, n=n)


def judge_scene(metrics: Mapping[str, Metric], comparisons: Iterable[Comparison]) -> dict[str, SceneFigures]:
    """The figures of each metric, which is reset, for one scene, whose comparisons are read one after the other.

    Raises:
        ValueError: A comparison cannot be judged.
    """
    rows: dict[str, dict[str, RowFigures]] = {name: {} for name in metrics}
    for index, comparison in enumerate(comparisons):
        checked(comparison)
        style = comparison.styles[0] if comparison.styles else f"{index:02d}"
        for name, metric in metrics.items():
            rows[name][style] = judge_row(name, metric, comparison)
    return {name: merge_rows(name, metric, rows[name]) for name, metric in metrics.items()}


@torch.no_grad()
def judge_row(name: str, metric: Metric, comparison: Comparison) -> RowFigures:
    """The figures of one metric for one comparison, which is :func:`~anystyle.perception.preprocess.checked`."""
    warned: list[str] = []
    metric.compute_with_cache = False  # a row's figure must not stand for the scene's
    metric.reset()
    with _record_warnings(warned, name):
        metric.update(comparison.to(metric.device))
    with warnings.catch_warnings():
        # Too few images are warned of for the scene, whose figure counts.
        warnings.simplefilter("ignore")
        figures = _floats(metric.compute())
    return RowFigures(figures, _copy(metric.metric_state), tuple(warned))


def merge_rows(name: str, metric: Metric, rows: Mapping[str, RowFigures]) -> SceneFigures:
    """The figures of one metric for a scene, from those of its styles, which this or an earlier run computed."""
    warned = [text for row in rows.values() for text in row.warned]
    states = [_copy(row.state, metric.device) for row in rows.values()]
    metric.compute_with_cache = False
    metric.reset()
    for key, value in states[-1].items() if states else ():
        setattr(metric, key, value)
    metric._update_count = 1
    for state in reversed(states[:-1]):
        metric.merge_state(state)
    with _record_warnings(warned, name):
        figures = _floats(metric.compute())
    metric.reset()
    styles = {style: row.figures for style, row in rows.items()}
    return SceneFigures(figures, styles, dict(metric.better), dict(metric.stand_ins), tuple(dict.fromkeys(warned)))


def aggregate(scenes: Mapping[str, Mapping[str, SceneFigures]], *, n: int) -> Evaluation:
    """The figures over all scenes, from those of each; ``n`` is the number of stylized images."""
    results = [figures for metrics in scenes.values() for figures in metrics.values()]
    warned = [text for result in results for text in result.warned]
    by_scene = {
        scene: {name: value for result in metrics.values() for name, value in result.figures.items()}
        for scene, metrics in scenes.items()
    }
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for scene, metrics in scenes.items():
        for result in metrics.values():
            for style, figures in result.styles.items():
                rows.setdefault((scene, style), {}).update(figures)
    means: dict[str, float] = {}
    for name in dict.fromkeys(name for figures in by_scene.values() for name in figures):
        values = {scene: figures.get(name, math.nan) for scene, figures in by_scene.items()}
        means[name] = mean(list(values.values()))
        lacking = [scene for scene, value in values.items() if math.isnan(value)]
        if 0 < len(lacking) < len(scenes):
            warned.append(f"{name} is the mean over the scenes but {', '.join(lacking)}, which have too little for it")
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


@contextmanager
def _record_warnings(texts: list[str], metric: str) -> Iterator[None]:
    """Collect warnings, once each, and log them instead of showing them."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        text = " ".join(str(warning.message).split())
        if text not in texts:
            texts.append(text)
            log.info("metric %s: %s", metric, text)


def _copy(state: Mapping[str, Any], device: torch.device | None = None) -> dict[str, Any]:
    # `reset` empties lists in place.
    return {
        name: [item.to(device=device) for item in value] if isinstance(value, list) else value.to(device=device)
        for name, value in state.items()
    }


def _floats(figures: Mapping[str, Tensor]) -> dict[str, float]:
    return {name: float(value) for name, value in figures.items()}
