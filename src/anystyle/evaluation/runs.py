"""What lies in folders of runs: evaluations, trainings, the jobs of a multirun, and what became of each."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec
from omegaconf import DictConfig, OmegaConf, open_dict

from anystyle.documents import kept_json, read_json, read_yaml
from anystyle.errors import UserError
from anystyle.evaluation import record
from anystyle.evaluation.contract import Evaluation
from anystyle.io.checkpoint import Header, read_header

OVERRIDES = Path(".hydra") / "overrides.yaml"
SWEEP = "multirun.yaml"
_LEFT = ("last.ckpt",)

State = Literal["finished", "unfinished", "failed", "missing"]


@dataclass(frozen=True)
class Run:
    """One job, or one evaluation.

    Args:
        folder: Where it lies.
        words: The overrides that it was started with.
        state: What became of it; ``missing`` is a job of a multirun that left no folder.
        evaluation: Where it was judged.
        logged: The last values that a training logged.
    """

    folder: Path
    words: tuple[str, ...]
    state: State
    evaluation: Path | None = None
    logged: Mapping[str, float] = field(default_factory=dict)

    def record(self) -> Evaluation:
        """Its figures: those of its evaluation, or else what it logged."""
        stored = None if self.evaluation is None else record.read(self.evaluation)
        return stored or Evaluation(self.logged, n=0)


def find(folder: Path) -> list[Run]:
    """The runs in a folder, in order: itself, the jobs of a multirun, or the runs in its sub-folders.

    Raises:
        ValueError: There is no such folder, or no run in it.
    """
    if not folder.is_dir():
        raise ValueError(f"there is no folder {folder}; name a run, a multirun or an evaluation")
    runs = [_run(folder)] if _is_run(folder) else sorted(_inside(folder), key=_place)
    if not runs:
        raise ValueError(
            f"{folder} holds no runs; expected an evaluation (metrics.json), a training, or a multirun with its jobs"
        )
    return runs


def _inside(folder: Path) -> Iterator[Run]:
    folders = (path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    folders = sorted(folders, key=job_order)
    known = [path for path in folders if _is_run(path)]
    words = _expected(folder / SWEEP)
    for number, overrides in enumerate(words):
        if not (folder / str(number)).is_dir():
            yield Run(folder / str(number), overrides, "missing")
        elif folder / str(number) not in known:
            yield Run(folder / str(number), overrides, "failed")
    for path in known:
        run = _run(path)
        planned = path.name.isdigit() and int(path.name) < len(words)
        yield Run(path, words[int(path.name)], run.state, run.evaluation, run.logged) if planned else run
    if not known and not words:
        for path in folders:
            yield from _inside(path)


def _is_run(folder: Path) -> bool:
    return (folder / record.FILE).is_file() or (folder / OVERRIDES).is_file() or bool(_evaluation(folder))


def _run(folder: Path) -> Run:
    evaluation = _evaluation(folder)
    logged = _logged(folder / record.FILE)
    trained = bool(logged) or any(folder.glob("*.safetensors"))
    state: State = "finished" if evaluation or trained else "unfinished"
    if state == "unfinished" and not any((folder / name).is_file() for name in _LEFT):
        state = "failed"
    return Run(folder, _words(folder / OVERRIDES), state, evaluation, logged)


def _evaluation(folder: Path) -> Path | None:
    inside = sorted(path.parent for path in folder.glob(f"*/{record.FILE}"))
    return next((path for path in (folder, folder / "evaluation", *inside) if record.read(path) is not None), None)


def _logged(path: Path) -> dict[str, float]:
    stored: dict[str, Any] | None = kept_json(path, dict[str, Any])
    if stored is None or "provenance" in stored:
        return {}
    return {name: math.nan if value is None else float(value) for name, value in stored.items() if _is_figure(value)}


def _is_figure(value: Any) -> bool:
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _words(path: Path) -> tuple[str, ...]:
    """The words that a run was started with; none where they cannot be read."""
    try:
        return tuple(read_yaml(path, list[str], what="list of overrides"))
    except UserError:
        return ()


class _Overrides(msgspec.Struct):
    task: list[str] = []


class _Hydra(msgspec.Struct):
    overrides: _Overrides


class _Sweep(msgspec.Struct):
    """The part of ``multirun.yaml`` that says which jobs there were to be."""

    hydra: _Hydra


def _expected(path: Path) -> list[tuple[str, ...]]:
    """The overrides of every job that a multirun was to have, in Hydra's order; none where that is not known."""
    if not path.is_file():
        return []
    from itertools import product

    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        sweep: _Sweep = read_yaml(path, _Sweep, what="record of a multirun")
        words = sweep.hydra.overrides.task
        parsed = OverridesParser.create().parse_overrides(words)
        lists = [
            [f"{item.get_key_element()}={value}" for value in item.sweep_string_iterator()]
            if item.is_sweep_override()
            else [str(item.input_line)]
            for item in parsed
        ]
    except (UserError, HydraException):
        return []
    return [tuple(words) for words in product(*lists)]


def _place(run: Run) -> tuple[str, tuple[int, str]]:
    return run.folder.parent.as_posix(), job_order(run.folder)


def job_order(path: Path) -> tuple[int, str]:
    """A key that sorts the jobs of a multirun by number, and other folders behind them by name."""
    return (int(path.name), "") if path.name.isdigit() else (1 << 30, path.name)


BRANCH = "branch.safetensors"


@dataclass(frozen=True)
class TrainedRun:
    """A run that wrote a style branch.

    Args:
        folder: Of the run.
        branch: Its weights.
        header: What they say of themselves.
        weights: Names or files of the other parts, as the run was configured.
    """

    folder: Path
    branch: Path
    header: Header
    weights: dict[str, Any]

    def into(self, config: DictConfig) -> DictConfig:
        """A configuration with the parts, options and weights of this run."""
        merged = config.copy()
        with open_dict(merged):
            for part, node in self.header.config.items():
                merged[part] = OmegaConf.create(node) if isinstance(node, dict) else node
            merged.weights = {**self.weights, "branch": str(self.branch)}
        return merged


def trained_runs(folder: Path) -> list[TrainedRun]:
    """The runs in a folder: itself, or the jobs of a multirun, in order.

    Raises:
        ValueError: None of them is finished.
    """
    if not folder.is_dir():
        raise ValueError(f"there is no run {folder}")
    jobs = sorted((path.parent for path in folder.glob(f"*/{BRANCH}")), key=job_order)
    folders = [folder] if (folder / BRANCH).is_file() else jobs
    if not folders:
        raise ValueError(f"{folder} holds no finished training of a style branch ({BRANCH}, in it or in its jobs)")
    return [_trained_run(folder) for folder in folders]


def _trained_run(folder: Path) -> TrainedRun:
    record = folder / "bound.json"
    what = "record of a run, which says on which weights it was trained"
    bound: dict[str, Any] = read_json(record, dict[str, Any], what=what)
    weights = {key.removeprefix("weights."): value for key, value in bound.items() if key.startswith("weights.")}
    return TrainedRun(folder, folder / BRANCH, read_header(folder / BRANCH), weights)
