"""What a protocol promises: see :class:`anystyle.contracts.Protocol`."""

import functools
import json
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch

from anystyle.contracts.protocol import Evaluation, Protocol
from anystyle.testing import asserts
from anystyle.testing.subject import Subject
from anystyle.testing.toy.metric import ToyMetric
from anystyle.testing.toy.scenes import ToyScenes
from anystyle.testing.toy.styles import ToyStyles
from anystyle.testing.toy.stylizer import ToyStylizer
from anystyle.types import OnProgress, Progress, no_progress
from anystyle.types.seeds import seeded


def test_scores_are_numbers(plugin: Subject[Protocol]) -> None:
    """It returns at least one score, a float by its name; ``better`` names scores, ``provenance`` fits JSON."""
    evaluation = _first(plugin)
    assert isinstance(evaluation, Evaluation) and evaluation.scores, f"`run` returned {str(evaluation)[:100]}"
    tables = [evaluation.scores, *evaluation.groups.values(), *(row.scores for row in evaluation.rows)]
    scores = [(name, value) for table in tables for name, value in table.items()]
    for name, value in scores:
        assert name.isidentifier() and type(value) is float, f"the score {name!r}: {value!r}"
    strange = {*evaluation.better, *evaluation.stand_ins} - {name for name, _ in scores}
    valid = not strange and set(evaluation.better.values()) <= {"higher", "lower"}
    assert valid, f"better={evaluation.better!r}, stand_ins={evaluation.stand_ins!r} of other scores: {strange}"
    assert evaluation.n > 0, f"n={evaluation.n}; count what was judged"
    json.dumps(dict(evaluation.provenance))


def test_scores_are_reproducible(plugin: Subject[Protocol]) -> None:
    """A second run in a new folder gives the same scores, bit for bit, and reports progress."""
    calls: list[Progress] = []
    second = _run(plugin, on_progress=calls.append)
    asserts.same(_scores(second), _scores(_first(plugin)), "the scores of a second run")
    assert calls and all(call.line and 0 <= (call.done or 0) <= 1 for call in calls), f"it reported {calls[:4]}"


def test_interrupted_runs_resume(plugin: Subject[Protocol]) -> None:
    """Interrupted at any step and started again in the same folder, it gives what an uninterrupted run gives."""
    calls: list[Progress] = []

    def interrupt(progress: Progress) -> None:
        calls.append(progress)
        if len(calls) in (2, 6):
            raise KeyboardInterrupt

    with tempfile.TemporaryDirectory() as folder:
        for _ in range(2):
            with suppress(KeyboardInterrupt):
                _run(plugin, folder, interrupt)
        for what in ("an interrupted run that went on", "a run in the folder of a finished one"):
            asserts.same(_scores(_run(plugin, folder)), _scores(_first(plugin)), f"the scores of {what}")


def runtime() -> dict[str, Any]:
    """The runtime arguments that a protocol is checked with, by name."""
    with seeded(0):
        stylizer = ToyStylizer()
    return {
        "stylizer": stylizer.requires_grad_(False).eval(),
        "metrics": {"toy": ToyMetric()},
        "scenes": ToyScenes(num_scenes=2, views=2, size=(16, 16)),
        "styles": ToyStyles(size=16, period=8),
    }


def _run(plugin: Subject[Protocol], folder: str | None = None, on_progress: OnProgress = no_progress) -> Evaluation:
    with tempfile.TemporaryDirectory() as new, seeded(0):
        return plugin.build(**runtime()).run(Path(folder or new), on_progress)


@functools.cache
def _first(plugin: Subject[Protocol]) -> Evaluation:
    return _run(plugin)


def _scores(evaluation: Evaluation) -> dict[str, Any]:
    tables = {"": evaluation.scores, **evaluation.groups}
    tables |= {f"row {row.scene} {row.style}": row.scores for row in evaluation.rows}
    exact = functools.partial(torch.tensor, dtype=torch.float64)
    return {table: {key: exact(value) for key, value in scores.items()} for table, scores in tables.items()}
