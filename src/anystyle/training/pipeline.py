"""A pipeline of trainings, each of which starts from the weights that earlier ones exported."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.vision.weights import FOLDERS, files, row

WEIGHTS = "weights"
"""Folder of the exported weights below that of the pipeline, under the file names by which trainings load them."""
RESERVED = ("experiment", "name", "out")
"""Options that a pipeline sets for its trainings itself."""


def _launch(overrides: Sequence[str], environment: Mapping[str, str]) -> int:
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


def train_pipeline(
    pipeline: Mapping[str, Mapping[str, str]],
    overrides: Sequence[str],
    out: Path,
    *,
    launch: Callable[[Sequence[str], Mapping[str, str]], int] = _launch,
) -> tuple[Path, ...]:
    """Run trainings that look for weights among those exported by earlier ones, and return the files of weights.

    ``pipeline`` gives for each experiment the part that it exports, and the name of that part's weights. Each is a run
    of its own below ``out``: the same call resumes the one that was stopped.
    """
    for experiment, exports in pipeline.items():
        if len(exports) != 1 or not set(exports.values()) <= set(files()):
            raise UserError(
                f"pipeline.{experiment} is {dict(exports)}; give one part and the name of its weights, "
                f"such as {{backbone: NAME}}"
            )
    folder = out.absolute() / WEIGHTS
    folder.mkdir(parents=True, exist_ok=True)
    search_path = os.pathsep.join(filter(None, [str(folder), os.environ.get(FOLDERS)]))
    overrides = [word for word in overrides if word.lstrip("+").partition("=")[0] not in RESERVED]
    chosen = {word.partition("=")[0] for word in overrides}
    weights: list[Path] = []
    made: list[str] = []  # weights of parts that the words choose, which no preset names
    for experiment, exports in pipeline.items():
        ((part, name),) = exports.items()
        run = out.absolute() / experiment
        reserved = [f"experiment={experiment}", f"name={experiment}", f"hydra.run.dir='{run}'"]
        status = launch([*reserved, *overrides, *made], {FOLDERS: search_path})
        exported = run / f"{part}.safetensors"
        if status or not exported.is_file():
            raise UserError(f"the pipeline stopped in experiment={experiment}; the same command resumes there")
        weights.append(folder / row(name).file)
        with atomic_path(weights[-1]) as temporary:
            shutil.copyfile(exported, temporary)
        made += [f"weights.{part}='{weights[-1]}'"] if part in chosen else []
    return tuple(weights)
