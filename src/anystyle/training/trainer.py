"""The trainer of a configuration, with its loggers."""

import sys
from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import numpy as np
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import LearningRateMonitor, ThroughputMonitor
from lightning.pytorch.loggers import CSVLogger, Logger, MLFlowLogger, TensorBoardLogger, WandbLogger
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import did_you_mean, one_line
from anystyle.training.callbacks import ProgressLines, SkippedData, StepSeed, num_images
from anystyle.training.options import SHARDED
from anystyle.training.safeguards import FiniteLoss, SkipOutliers
from anystyle.training.sharding import Sharded


def make_trainer(config: DictConfig, out: Path, callbacks: list[pl.Callback]) -> pl.Trainer:
    """Build the trainer of a run; ``config.trainer`` holds options of Lightning's.

    Raises:
        ValueError: This machine cannot fulfil an option, or Lightning does not know it.
    """
    plain = OmegaConf.to_container(config.trainer, resolve=True)
    assert isinstance(plain, dict)
    options: dict[str, Any] = {str(key): value for key, value in plain.items()}
    if options.get("strategy") == SHARDED:
        options["strategy"] = Sharded(save_distributed_checkpoint=False)
    terminal = sys.stderr.isatty()
    guards: list[pl.Callback] = [
        StepSeed(config.seed),
        FiniteLoss(out / "refused_batch.pt", growth=None if config.explosion is None else float(config.explosion)),
        LearningRateMonitor(),
        ThroughputMonitor(num_images, window_size=20),
        SkippedData(out / "skipped.txt"),
    ]
    if config.skip_outliers:
        guards.append(SkipOutliers())
    if not terminal:
        guards.append(ProgressLines())
    try:
        return pl.Trainer(
            **options,
            default_root_dir=out,
            max_epochs=-1,
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            use_distributed_sampler=False,
            enable_checkpointing=False,
            enable_model_summary=False,
            enable_progress_bar=terminal,
            logger=make_loggers(list(config.loggers), out, str(config.name)),
            callbacks=[*guards, *callbacks],
        )
    except TypeError as error:
        raise ValueError(f"trainer: {error}; the options are those of lightning's Trainer") from None
    except (MisconfigurationException, ValueError) as error:
        way_out = "" if options.get("accelerator") == "cpu" else "; trainer=cpu does without a graphics card"
        raise ValueError(f"trainer: {one_line(error).rstrip('.!')}{way_out}") from None


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
