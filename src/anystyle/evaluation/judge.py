"""Feeding comparisons to metrics: figures of each row, of each scene, and over all scenes."""

import logging
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.evaluation.contract import Evaluation, Row
from anystyle.types import Comparison

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SceneFigures:
    """What one metric says of one scene.

    Args:
        figures: Over all styles.
        styles: Of each style, in order.
        better: ``higher`` or ``lower`` by figure.
        stand_ins: The stand-in network behind a figure, where there is one.
        warned: What the metric warned of.
    """

    figures: Mapping[str, float]
    styles: Mapping[str, Mapping[str, float]]
    better: Mapping[str, str] = field(default_factory=dict)
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    warned: tuple[str, ...] = ()


@dataclass(frozen=True)
class Judged:
    """What one metric took in of one scene in one style.

    Args:
        figures: Of this comparison alone.
        state: The metric's, as :meth:`torchmetrics.Metric.merge_state` takes it.
        warned: What it warned of.
    """

    figures: Mapping[str, float]
    state: Mapping[str, Any]
    warned: tuple[str, ...] = ()


def judge(metrics: Mapping[str, Metric], comparisons: Iterable[Comparison]) -> Evaluation:
    """The figures of some metrics over comparisons of one scene in one style each.

    Every image is seen once: a metric takes in a row, says what it is worth, and rows are merged for what the scene
    is worth. Over several scenes a figure is the mean of the scenes' figures, as published tables have one a scene.

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
    return gathered({scene: judge_scene(metrics, rows) for scene, rows in by_scene.items()}, n=n)


@torch.no_grad()
def judge_scene(
    metrics: Mapping[str, Metric],
    comparisons: Iterable[Comparison],
    told: Callable[[], None] = lambda: None,
) -> dict[str, SceneFigures]:
    """What each metric says of one scene, whose comparisons are read one after the other.

    Args:
        metrics: By name; they are reset.
        comparisons: One a style, each with one scene.
        told: Called after each.

    Raises:
        ValueError: A comparison cannot be judged.
    """
    rows: dict[str, dict[str, Judged]] = {name: {} for name in metrics}
    for place, comparison in enumerate(comparisons):
        check(comparison)
        style = comparison.styles[0] if comparison.styles else f"{place:02d}"
        for name, metric in metrics.items():
            rows[name][style] = judge_row(name, metric, comparison)
        told()
    return {name: merged(name, metric, rows[name]) for name, metric in metrics.items()}


@torch.no_grad()
def judge_row(name: str, metric: Metric, comparison: Comparison) -> Judged:
    """What one metric says of one comparison; see :func:`check` for what it cannot judge."""
    warned: list[str] = []
    metric.compute_with_cache = False  # a row's figure must not stand for the scene's
    metric.reset()
    with _heard(warned, f"metric {name}"):
        metric.update(comparison.to(metric.device))
    with warnings.catch_warnings():
        # Of too few images for a figure; the scene's figure, which counts, warns for itself.
        warnings.simplefilter("ignore")
        figures = numbers(metric.compute())
    return Judged(figures, _copied(metric.metric_state), tuple(warned))


def merged(name: str, metric: Metric, rows: Mapping[str, Judged]) -> SceneFigures:
    """What a metric says of a scene, from what it took in of each style, now or in an earlier run."""
    warned = [text for row in rows.values() for text in row.warned]
    states = [_copied(row.state, metric.device) for row in rows.values()]
    metric.compute_with_cache = False
    metric.reset()
    for key, value in states[-1].items() if states else ():
        setattr(metric, key, value)
    metric._update_count = 1
    for state in reversed(states[:-1]):
        metric.merge_state(state)
    with _heard(warned, f"metric {name}"):
        figures = numbers(metric.compute())
    metric.reset()
    styles = {style: row.figures for style, row in rows.items()}
    return SceneFigures(figures, styles, dict(metric.better), dict(metric.stand_ins), tuple(dict.fromkeys(warned)))


def check(comparison: Comparison) -> None:
    """Refuse what no metric can judge.

    Raises:
        ValueError: Sizes differ, or a value is no number.
    """
    where = " ".join(filter(None, [*comparison.scenes[:1], "in style", *comparison.styles[:1]]))
    for what in ("content", "stylized"):
        if not bool(getattr(comparison, what).isfinite().all()):
            raise ValueError(f"{where}: the {what} images hold NaN or infinity; nothing can be said of them")
    if comparison.content.shape != comparison.stylized.shape:
        raise ValueError(
            f"{where}: photographs are {_shape(comparison.content)} and stylized images {_shape(comparison.stylized)};"
            " give as many of one size"
        )


def gathered(scenes: Mapping[str, Mapping[str, SceneFigures]], *, n: int) -> Evaluation:
    """The figures of several scenes together, from those of each.

    Args:
        scenes: For each scene, what each metric said.
        n: How many stylized images there were.
    """
    per_scene: dict[str, dict[str, float]] = {}
    rows: list[Row] = []
    better: dict[str, str] = {}
    stand_ins: dict[str, str] = {}
    warned: list[str] = []
    for scene, metrics in scenes.items():
        per_scene[scene] = {}
        styles: dict[str, dict[str, float]] = {}
        for found in metrics.values():
            per_scene[scene].update(found.figures)
            for style, figures in found.styles.items():
                styles.setdefault(style, {}).update(figures)
            better.update(found.better)
            stand_ins.update(found.stand_ins)
            warned.extend(found.warned)
        rows.extend(Row(scene, style, figures) for style, figures in styles.items())
    names = list(dict.fromkeys(name for figures in per_scene.values() for name in figures))
    for name in names:
        lacking = [scene for scene, found in per_scene.items() if math.isnan(found.get(name, math.nan))]
        if 0 < len(lacking) < len(per_scene):
            warned.append(f"{name} is the mean over the scenes but {', '.join(lacking)}, which have too little for it")
    figures = {name: mean([per_scene[scene].get(name, math.nan) for scene in per_scene]) for name in names}
    groups = {f"scene {scene}": values for scene, values in per_scene.items()} if len(per_scene) > 1 else {}
    return Evaluation(
        figures=figures,
        n=n,
        better=better,
        groups=groups,
        rows=tuple(rows),
        stand_ins=stand_ins,
        provenance={"scenes": list(per_scene), "warnings": list(dict.fromkeys(warned))},
    )


def mean(values: Sequence[float]) -> float:
    """The mean of those values that are numbers; ``nan`` where none is."""
    known = [value for value in values if not math.isnan(value)]
    return math.fsum(known) / len(known) if known else math.nan


def numbers(figures: Mapping[str, Tensor]) -> dict[str, float]:
    """Figures as plain numbers."""
    return {name: float(value) for name, value in figures.items()}


class _heard(warnings.catch_warnings):
    """Collect warnings, once each, instead of showing them; also in the log."""

    def __init__(self, into: list[str], source: str) -> None:
        super().__init__(record=True)
        self._into, self._source = into, source

    def __enter__(self) -> None:
        self._caught: Any = super().__enter__()
        warnings.simplefilter("always")

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        for warning in self._caught:
            text = " ".join(str(warning.message).split())
            if text not in self._into:
                self._into.append(text)
                log.info("%s: %s", self._source, text)


def _copied(state: Mapping[str, Any], device: torch.device | None = None) -> dict[str, Any]:
    # `reset` empties lists in place.
    return {
        name: [item.to(device=device) for item in value] if isinstance(value, list) else value.to(device=device)
        for name, value in state.items()
    }


def _shape(images: Tensor) -> str:
    _, number, _, height, width = images.shape
    return f"{number} of {width}x{height} pixels"
