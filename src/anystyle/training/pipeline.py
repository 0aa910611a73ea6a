"""A pipeline of trainings, each of which starts from the weights that earlier ones exported."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from anystyle.io.atomic import atomic_path
from anystyle.perception.weights import FOLDERS, files, row

WEIGHTS = "weights"
"""Folder of the exported weights below that of the pipeline, under the file names by which trainings load them."""
RESERVED = ("experiment", "name", "out")
"""Options that a pipeline sets for its trainings itself."""


@dataclass(frozen=True)
class Stage:
    """One training of a pipeline.

    Args:
        experiment: Its recipe.
        part: The part that it exports.
        weights: The name of that part's file in :func:`anystyle.perception.weights.files`.
    """

    experiment: str
    part: str
    weights: str


Launch = Callable[[Sequence[str], Mapping[str, str]], int]
"""Runs ``anystyle train`` with overrides and environment variables, and returns its exit status."""


def stages_of(pipeline: Mapping[str, Mapping[str, str]]) -> tuple[Stage, ...]:
    """The stages of a configuration's ``pipeline``: for each experiment its part and the name of its weights.

    Raises:
        ValueError: A name is not one of weights, or a training exports more than one part.
    """
    stages: list[Stage] = []
    for experiment, exports in pipeline.items():
        if len(exports) != 1 or not set(exports.values()) <= set(files()):
            raise ValueError(
                f"pipeline.{experiment} is {dict(exports)}; give one part and the name of its weights, "
                f"such as {{backbone: NAME}}"
            )
        ((part, weights),) = exports.items()
        stages.append(Stage(experiment, part, weights))
    return tuple(stages)


def forwarded(overrides: Sequence[str]) -> list[str]:
    """The overrides that every training of a pipeline gets too."""
    return [word for word in overrides if word.lstrip("+").partition("=")[0] not in RESERVED]


def train_pipeline(
    stages: Sequence[Stage], overrides: Sequence[str], out: Path, *, launch: Launch | None = None
) -> tuple[Path, ...]:
    """Run trainings that look for weights among those exported by earlier ones, and then among the bundled ones.

    Each is a run of its own with the overrides, below ``out`` under its experiment's name: the same call continues the
    one that was stopped, and finished ones only export their weights again.

    Returns:
        The files of weights.

    Raises:
        ValueError: A training failed, or was stopped.
    """
    folder = out.absolute() / WEIGHTS
    folder.mkdir(parents=True, exist_ok=True)
    search_path = os.pathsep.join(filter(None, [str(folder), os.environ.get(FOLDERS)]))
    weights: list[Path] = []
    for stage in stages:
        run = out.absolute() / stage.experiment
        reserved = [f"experiment={stage.experiment}", f"name={stage.experiment}", f"hydra.run.dir='{run}'"]
        status = (launch or _process)([*reserved, *overrides], {FOLDERS: search_path})
        exported = run / f"{stage.part}.safetensors"
        if status or not exported.is_file():
            raise ValueError(
                f"the pipeline stopped in experiment={stage.experiment}; the same command goes on from there"
            )
        target = folder / row(stage.weights).file
        with atomic_path(target) as temporary:
            shutil.copyfile(exported, temporary)
        weights.append(target)
    return tuple(weights)


def _process(overrides: Sequence[str], environment: Mapping[str, str]) -> int:
    command = [sys.executable, "-m", "anystyle", "train", *overrides]
    with subprocess.Popen(command, env={**os.environ, **environment}) as process:
        # A terminal sends Ctrl-C to both processes; SIGTERM is forwarded. The training saves, and then it ends.
        handlers = {name: signal.getsignal(name) for name in (signal.SIGINT, signal.SIGTERM)}
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, lambda number, frame: process.send_signal(number))
            return process.wait()
        finally:
            for name, handler in handlers.items():
                signal.signal(name, handler)
