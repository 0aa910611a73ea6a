"""Trainings one after the other, each on top of the weights that those before it made."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from anystyle.files import atomic_path
from anystyle.perception.weights import FILES, FOLDERS

WEIGHTS = "weights"
"""Below the folder of a chain: what its trainings made, under the names by which others ask for them."""
OWN = ("experiment", "name", "out")
"""Words that a chain gives its trainings itself."""


@dataclass(frozen=True)
class Link:
    """One training of a chain.

    Args:
        experiment: Its recipe.
        part: What it exports.
        weights: The name in :data:`anystyle.perception.weights.FILES` under which later trainings find that.
    """

    experiment: str
    part: str
    weights: str


Launch = Callable[[Sequence[str], Mapping[str, str]], int]
"""Runs ``anystyle train`` with words and environment variables, and returns its exit status."""


def links(chain: Mapping[str, Mapping[str, str]]) -> tuple[Link, ...]:
    """The trainings of a configuration's ``chain``: for each experiment its part and the name of its weights.

    Raises:
        ValueError: A name is not one of weights, or a training makes more than one part.
    """
    found: list[Link] = []
    for experiment, made in chain.items():
        wrong = [name for name in made.values() if name not in FILES]
        if len(made) != 1 or wrong:
            raise ValueError(
                f"chain.{experiment} is {dict(made)}; give one part and the name of its weights, "
                f"such as {{backbone: tiny_backbone}}"
            )
        ((part, weights),) = made.items()
        found.append(Link(experiment, part, weights))
    return tuple(found)


def forwarded(words: Sequence[str]) -> list[str]:
    """The overrides that every training of a chain gets too."""
    return [word for word in words if word.lstrip("+").partition("=")[0] not in OWN]


def train_chain(
    chain: Sequence[Link], words: Sequence[str], out: Path, *, launch: Launch | None = None
) -> tuple[Path, ...]:
    """Run trainings that look for weights among those made before them, and then among the bundled ones.

    Each is a run of its own, below ``out`` under its experiment's name: the same call goes on with the one that was
    stopped, and finished ones only write their weights again.

    Args:
        chain: In order.
        words: Further overrides for each.
        out: The folder.
        launch: Runs one; a process of this Python if it is not given.

    Returns:
        The files of weights.

    Raises:
        ValueError: A training failed, or was stopped.
    """
    folder = out.absolute() / WEIGHTS
    folder.mkdir(parents=True, exist_ok=True)
    searched = os.pathsep.join(filter(None, [str(folder), os.environ.get(FOLDERS)]))
    made: list[Path] = []
    for link in chain:
        run = out.absolute() / link.experiment
        own = [f"experiment={link.experiment}", f"name={link.experiment}", f"hydra.run.dir='{run}'"]
        status = (launch or _process)([*own, *words], {FOLDERS: searched})
        exported = run / f"{link.part}.safetensors"
        if status or not exported.is_file():
            raise ValueError(f"the chain stopped in experiment={link.experiment}; the same command goes on from there")
        target = folder / FILES[link.weights].file
        with atomic_path(target) as temporary:
            shutil.copyfile(exported, temporary)
        made.append(target)
    return tuple(made)


def _process(words: Sequence[str], environment: Mapping[str, str]) -> int:
    command = [sys.executable, "-m", "anystyle", "train", *words]
    with subprocess.Popen(command, env={**os.environ, **environment}) as process:
        # A terminal sends Ctrl-C to both; whoever sends SIGTERM means the training too. It saves, and then it ends.
        before = {name: signal.getsignal(name) for name in (signal.SIGINT, signal.SIGTERM)}
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, lambda number, frame: process.send_signal(number))
            return process.wait()
        finally:
            for name, handler in before.items():
                signal.signal(name, handler)
