"""Loggers of a run by name: Lightning's own, and how each of them logs a picture."""

from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path

import numpy as np
from lightning.pytorch.loggers import CSVLogger, Logger, MLFlowLogger, TensorBoardLogger, WandbLogger
from numpy.typing import NDArray

from anystyle.errors import did_you_mean

Picture = NDArray[np.uint8]
"""Height, width, 3; sRGB levels."""

EXTRAS = {"csv": "", "tensorboard": "tracking", "wandb": "wandb", "mlflow": "mlflow"}
"""The names of loggers, and the extra that installs each."""


def make_loggers(names: Sequence[str], out: Path, name: str = "run") -> list[Logger]:
    """The loggers of these names, keys of :data:`EXTRAS`; each run of a continued training gets a version of its own.

    ``csv`` is among them always: a table of the run costs nothing and needs nobody's server.

    Raises:
        ValueError: A name is unknown.
        ImportError: A logger's package is not installed; the message names the extra.
    """
    for unknown in [each for each in names if each not in EXTRAS]:
        raise ValueError(
            f"loggers: no logger is named '{unknown}'.{did_you_mean(unknown, EXTRAS)} Choose from {', '.join(EXTRAS)}"
        )
    return [_logger(each, out, name) for each in dict.fromkeys(["csv", *names])]


def _logger(tracker: str, out: Path, name: str) -> Logger:
    try:
        match tracker:
            case "tensorboard":
                return TensorBoardLogger(out, name="tensorboard")
            case "wandb":
                return WandbLogger(name=name, project="anystyle", save_dir=out)
            case "mlflow":
                return MLFlowLogger(experiment_name="anystyle", run_name=name)
            case _:
                return CSVLogger(out, name="log", flush_logs_every_n_steps=20)
    except ModuleNotFoundError as error:
        raise ImportError(f'loggers: {tracker} is not installed; pip install "anystyle[{EXTRAS[tracker]}]"') from error


@singledispatch
def log_picture(logger: Logger, tag: str, picture: Picture, step: int) -> None:
    """Log a picture under a tag at a step; tables take none."""


@log_picture.register
def _(logger: TensorBoardLogger, tag: str, picture: Picture, step: int) -> None:
    logger.experiment.add_image(tag, picture, step, dataformats="HWC")


@log_picture.register
def _(logger: WandbLogger, tag: str, picture: Picture, step: int) -> None:
    logger.log_image(key=tag, images=[picture], step=step)


@log_picture.register
def _(logger: MLFlowLogger, tag: str, picture: Picture, step: int) -> None:
    logger.experiment.log_image(logger.run_id, picture, key=tag, step=step)
