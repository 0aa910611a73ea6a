"""Where the numbers and pictures of a run go: by name, each behind Lightning's own logger."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lightning.pytorch.loggers import CSVLogger, Logger
from numpy.typing import NDArray

from anystyle.errors import did_you_mean

Picture = NDArray[np.uint8]
"""Height, width, 3."""


def _csv(out: Path, name: str) -> Logger:
    return CSVLogger(out, name="log", flush_logs_every_n_steps=20)


def _tensorboard(out: Path, name: str) -> Logger:
    from lightning.pytorch.loggers import TensorBoardLogger

    return TensorBoardLogger(out, name="tensorboard")


def _wandb(out: Path, name: str) -> Logger:
    from lightning.pytorch.loggers import WandbLogger

    return WandbLogger(name=name, project="anystyle", save_dir=out)


def _mlflow(out: Path, name: str) -> Logger:
    from lightning.pytorch.loggers import MLFlowLogger

    return MLFlowLogger(experiment_name="anystyle", run_name=name)


def _no_picture(logger: Any, tag: str, picture: Picture, step: int) -> None:
    """Tables hold no pictures; the files in ``previews/`` do."""


def _tensorboard_picture(logger: Any, tag: str, picture: Picture, step: int) -> None:
    logger.experiment.add_image(tag, picture, step, dataformats="HWC")


def _wandb_picture(logger: Any, tag: str, picture: Picture, step: int) -> None:
    logger.log_image(key=tag, images=[picture], step=step)


def _mlflow_picture(logger: Any, tag: str, picture: Picture, step: int) -> None:
    logger.experiment.log_image(logger.run_id, picture, key=tag, step=step)


@dataclass(frozen=True)
class Tracker:
    """One way to follow a run.

    Args:
        make: Builds the logger from the run's folder and name.
        show: Gives it a picture.
        extra: What installs it; empty where nothing is needed.
    """

    make: Callable[[Path, str], Logger]
    show: Callable[[Any, str, Picture, int], None]
    extra: str = ""


TRACKERS: dict[str, Tracker] = {
    "csv": Tracker(_csv, _no_picture),
    "tensorboard": Tracker(_tensorboard, _tensorboard_picture, "tracking"),
    "wandb": Tracker(_wandb, _wandb_picture, "wandb"),
    "mlflow": Tracker(_mlflow, _mlflow_picture, "mlflow"),
}

_CLASSES = {
    "CSVLogger": "csv",
    "TensorBoardLogger": "tensorboard",
    "WandbLogger": "wandb",
    "MLFlowLogger": "mlflow",
}


def make_loggers(names: Sequence[str], out: Path, name: str = "run") -> list[Logger]:
    """The loggers of these names; each run of a training that is continued gets a version of its own.

    ``csv`` is among them always: a table of the run costs nothing and needs nobody's server.

    Args:
        names: Keys of :data:`TRACKERS`.
        out: The run's folder.
        name: The run's name, for trackers that gather several runs.

    Raises:
        ValueError: A name is unknown.
        ImportError: What it needs is not installed; the message names the extra.
    """
    return [_made(each, out, name) for each in dict.fromkeys(["csv", *names])]


def _made(tracker: str, out: Path, name: str) -> Logger:
    if tracker not in TRACKERS:
        raise ValueError(
            f"loggers: no logger is named '{tracker}'.{did_you_mean(tracker, TRACKERS)} Choose from "
            f"{', '.join(TRACKERS)}"
        )
    try:
        return TRACKERS[tracker].make(out, name)
    except ModuleNotFoundError as error:
        extra = TRACKERS[tracker].extra
        raise ImportError(f'loggers: {tracker} is not installed; pip install "anystyle[{extra}]"') from error


def show(loggers: Sequence[Logger], tag: str, picture: Picture, step: int) -> None:
    """Give a picture to every logger that takes some.

    Args:
        loggers: Of a trainer.
        tag: What it shows.
        picture: Levels of red, green and blue.
        step: Steps done.
    """
    for logger in loggers:
        TRACKERS[_CLASSES[type(logger).__name__]].show(logger, tag, picture, step)
