"""What a protocol promises: see :class:`anystyle.evaluation.contract.Protocol`."""

import inspect
import json
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anystyle.evaluation.contract import Evaluation, Protocol
from anystyle.testing.check import Check, attempt, expect, refusal
from anystyle.testing.comparing import expect_same
from anystyle.testing.subject import Subject, seeded
from anystyle.testing.toy.metric import ToyMetric
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.styles import ToyStyles
from anystyle.testing.toy.stylizer import ToyStylizer

Plugin = Subject[Protocol]


class _Interrupted(BaseException):
    """What Ctrl-C raises, but for the name."""


def figures_are_numbers(plugin: Plugin) -> None:
    """It returns at least one figure; names are of letters, digits and '_', and ``better`` speaks of those it has."""
    evaluation = _first(plugin)
    change = "return Evaluation(figures={'name': 1.0}, n=..., better={'name': 'higher'})"
    expect(
        isinstance(evaluation, Evaluation) and len(evaluation.figures) > 0,
        given=f"`run` returned {str(evaluation)[:100]}",
        expected="an Evaluation with at least one figure",
        change=change,
    )
    tables = [evaluation.figures, *evaluation.groups.values(), *(row.figures for row in evaluation.rows)]
    wrong = [
        f"{name!r}: {value!r}"
        for figures in tables
        for name, value in figures.items()
        if not (isinstance(name, str) and name.isidentifier() and type(value) is float)
    ]
    expect(not wrong, given=f"the figure {wrong[0] if wrong else ''}", expected="a float by its name", change=change)
    strange = sorted({*evaluation.better, *evaluation.stand_ins} - {name for figures in tables for name in figures})
    expect(
        not strange and set(evaluation.better.values()) <= {"higher", "lower"},
        given=f"`better` is {dict(evaluation.better)!r}, `stand_ins` name {sorted(evaluation.stand_ins)}",
        expected="'higher' or 'lower' for figures that it returns, and stand-ins of these",
        change=change,
    )


def it_says_what_figures_rest_on(plugin: Plugin) -> None:
    """The number of samples is positive, and the provenance is plain values that JSON can hold."""
    evaluation = _first(plugin)
    expect(
        evaluation.n > 0,
        given=f"n={evaluation.n}",
        expected="how many samples there were",
        change="count what was judged",
    )
    expect(
        isinstance(evaluation.provenance, Mapping), given="no mapping", expected="values by name", change="use a dict"
    )
    change = "write numbers, texts, lists and mappings; turn tensors and paths into these"
    with attempt("writing `provenance` as JSON", change=change):
        json.dumps(dict(evaluation.provenance))


def it_tells_how_far_it_is(plugin: Plugin) -> None:
    """Progress is told from the start to the end, and never beyond."""
    calls: list[tuple[str, int, int]] = []
    with _folder() as out, seeded(0), attempt("`run`", change="see the line named above"):
        _make(plugin).run(out, lambda stage, done, total: calls.append((stage, done, total)))
    expect(
        len(calls) > 0 and all(stage and 0 <= done <= total for stage, done, total in calls),
        given=f"`progress` was called with {calls[:4]}",
        expected="a stage, how much of it is done and how much there is",
        change="call progress('scenes', done, total) in the loop that takes long",
    )


def it_is_reproducible(plugin: Plugin) -> None:
    """The same again in a new folder gives the same figures, bit for bit."""
    expect_same(
        _all_figures(_run(plugin)),
        _all_figures(_first(plugin)),
        what="the figures of a second run",
        change="draw random numbers from a generator with a seed of its own",
    )


def it_goes_on_where_it_was_stopped(plugin: Plugin) -> None:
    """Stopped at any step and started again in the same folder, it gives what an uninterrupted run gives."""
    with _folder() as out:
        for limit in (1, 3):
            _interrupted(plugin, out, limit)
        again = _run(plugin, out)
        repeated = _run(plugin, out)
    change = "write each finished piece with `anystyle.io.atomic.atomic_path`, and compute from what is written"
    for what, evaluation in (
        ("an interrupted run that went on", again),
        ("a run in the folder of a finished one", repeated),
    ):
        expect_same(
            _all_figures(evaluation), _all_figures(_first(plugin)), what=f"the figures of {what}", change=change
        )


def missing_sources_are_said(plugin: Plugin) -> None:
    """Without scenes, styles and metrics it works all the same, or raises a ValueError of one line."""
    change = "use `anystyle.evaluation.contract.required(scenes, 'scenes')`"
    parts = _named(plugin, _parts() | {"metrics": {}, "scenes": None, "styles": None})
    with attempt("a run without scenes and styles", change=change), refusal(change), _folder() as out, seeded(0):
        # Not by `build`, which would call the error expected here a broken promise.
        plugin.cls(**plugin.options, **parts).run(out, _silent)


def _parts() -> dict[str, Any]:
    with seeded(0):
        stylizer = ToyStylizer()
    return {
        "stylizer": stylizer.requires_grad_(False).eval(),
        "metrics": {"toy": ToyMetric()},
        "scenes": ToyScenes(num_scenes=2, views=2, size=(16, 16)),
        "styles": ToyStyles(size=16, period=8),
    }


def _named(plugin: Plugin, parts: dict[str, Any]) -> dict[str, Any]:
    known = inspect.signature(plugin.cls).parameters
    return {name: part for name, part in parts.items() if name in known}


def _make(plugin: Plugin) -> Protocol:
    return plugin.build(**_parts())


def _first(plugin: Plugin) -> Evaluation:
    return plugin.once("first", lambda: _run(plugin))


def _run(plugin: Plugin, out: Path | None = None) -> Evaluation:
    with _folder() as new, seeded(0), attempt("`run`", change="see the line named above"):
        return _make(plugin).run(out or new, _silent)


def _interrupted(plugin: Plugin, out: Path, limit: int) -> None:
    calls = 0

    def stop(stage: str, done: int, total: int) -> None:
        nonlocal calls
        calls += 1
        if calls > limit:
            raise _Interrupted

    try:
        with seeded(0):
            _make(plugin).run(out, stop)
    except _Interrupted:
        pass


def _silent(stage: str, done: int, total: int) -> None:
    """Nobody is told."""


def _all_figures(evaluation: Evaluation) -> dict[str, Tensor]:
    figures = {"": evaluation.figures, **evaluation.groups}
    figures |= {f"row {row.scene} {row.style}": row.figures for row in evaluation.rows}
    return {
        f"{group}.{name}": torch.tensor(value, dtype=torch.float64)
        for group, values in figures.items()
        for name, value in values.items()
    }


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


CHECKS: tuple[Check, ...] = (
    Check(figures_are_numbers, needed=True),
    Check(it_says_what_figures_rest_on),
    Check(it_tells_how_far_it_is),
    Check(it_is_reproducible),
    Check(it_goes_on_where_it_was_stopped),
    Check(missing_sources_are_said),
)
