"""The Lightning trainer of a configuration: the ranges of its options, its callbacks and its loggers."""

import sys
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import numpy as np
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import LearningRateMonitor
from lightning.pytorch.loggers import CSVLogger, Logger, MLFlowLogger, TensorBoardLogger, WandbLogger
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import UserError, one_line, unknown
from anystyle.registry.schema import option
from anystyle.training.callbacks import ProgressLines, StepSeed, StepThroughput
from anystyle.training.safeguards import FiniteLoss, SkipOutliers


def _at_least(least: int, expected: str = "") -> tuple[Callable[[Any], bool], str]:
    return lambda value: type(value) is int and value >= least, expected or f"give a whole number, at least {least}"


def _between(low: float, high: float, expected: str) -> tuple[Callable[[Any], bool], str]:
    return lambda value: value is None or low < float(value) < high, expected


def _one_of(*values: object) -> tuple[Callable[[Any], bool], str]:
    return lambda value: value in values, f"choose from {', '.join(str(value).lower() for value in values)}"


MAX_WORKERS = 256

RANGES: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "seed": (lambda value: type(value) is int and 0 <= value < 1 << 63, "give a whole number, at least 0"),
    "workers": (
        lambda value: type(value) is int and 0 <= value <= MAX_WORKERS,
        f"give a number of processes, at most {MAX_WORKERS}; 0 reads in the training's own",
    ),
    "validation_steps": _at_least(0, "give a number of steps, 0 for no validation"),
    "checkpoint.every_steps": _at_least(1),
    "checkpoint.every_minutes": _between(0.0, np.inf, "give minutes above 0"),
    "average": _between(0.0, 1.0, "the average's decay is between 0 and 1, such as 0.999; null keeps none"),
    "explosion": _between(1.0, np.inf, "a loss may vary; give a factor above 1, such as 1000, or null to let it grow"),
    "resume": _one_of("auto", "never", "changed"),
    "loggers": (OmegaConf.is_list, "give a list, such as loggers=[tensorboard]"),
    **{name: _one_of(True, False) for name in ("fast_dev_run", "skip_outliers", "export.half")},
    "trainer.max_steps": _at_least(1, "the schedule needs an end; give at least 1"),
    **{
        f"trainer.{name}": _at_least(1)
        for name in ("log_every_n_steps", "val_check_interval", "accumulate_grad_batches", "num_nodes")
    },
    "trainer.max_time": (lambda value: value is None or isinstance(value, str), "give days and time as DD:HH:MM:SS"),
    "trainer.profiler": (lambda value: value is None or isinstance(value, str), "give simple, advanced or pytorch"),
    "trainer.deterministic": _one_of(None, True, False, "warn"),
    "trainer.gradient_clip_val": (lambda value: value is None or float(value) >= 0, "give a norm, or null"),
}
"""For each option the test of a value, and what is expected."""


_OURS = (
    "barebones", "callbacks", "check_val_every_n_epoch", "default_root_dir", "enable_checkpointing", "logger",
    "max_epochs", "min_epochs", "plugins", "reload_dataloaders_every_n_epochs", "use_distributed_sampler",
)  # fmt: skip
_HINTS = typing.get_type_hints(pl.Trainer.__init__)
TrainerOptions = make_dataclass(
    "TrainerOptions",
    [
        (name, option(hint | None), field(default=None))
        for name, hint in _HINTS.items()
        if name not in (*_OURS, "return")
    ],
)
"""The arguments of Lightning's Trainer but those that a run sets itself; ``None`` leaves each to Lightning."""


def check_options(config: DictConfig) -> None:
    """Check the options of the run and those of the trainer, as ``conf/train.yaml`` composes them."""
    for key, (is_valid, expected) in RANGES.items():
        value = OmegaConf.select(config, key, default=None)
        if value is None and key == "trainer.accumulate_grad_batches":
            continue
        try:
            valid = is_valid(value)
        except (TypeError, ValueError):  # not a number at all
            valid = False
        if not valid:
            raise UserError(f"{key}={value}: {expected}")
    trainer, precision = config.trainer, str(config.trainer.precision)
    if trainer.accelerator == "cpu" and precision.startswith("16"):
        raise UserError(
            f"trainer.precision={precision} on trainer.accelerator=cpu: half precision needs a graphics card; use "
            f"bf16-mixed or 32-true"
        )


def make_trainer(config: DictConfig, out: Path, callbacks: list[pl.Callback]) -> pl.Trainer:
    """Build the trainer of a run; ``config.trainer`` holds options of Lightning's."""
    values: Any = OmegaConf.to_container(config.trainer, resolve=True)
    is_terminal = sys.stderr.isatty()
    options = {"num_sanity_val_steps": 0, "enable_model_summary": False, "enable_progress_bar": is_terminal}
    options |= {name: value for name, value in values.items() if value is not None}
    common: list[pl.Callback] = [
        StepSeed(config.seed),
        FiniteLoss(out / "refused_batch.pt", growth=None if config.explosion is None else float(config.explosion)),
        LearningRateMonitor(),
        StepThroughput(lambda batch: getattr(batch, "num_images", 1), window_size=20),
        *([SkipOutliers()] if config.skip_outliers else []),
        *([] if options["enable_progress_bar"] else [ProgressLines()]),
    ]
    try:
        return pl.Trainer(
            **options,
            default_root_dir=out,
            max_epochs=-1,
            check_val_every_n_epoch=None,
            use_distributed_sampler=False,
            enable_checkpointing=False,
            logger=make_loggers(list(config.loggers), out, str(config.name)),
            callbacks=[*common, *callbacks],
        )
    except UserError:
        raise
    except TypeError as error:
        raise UserError(f"trainer: {error}; the options are those of lightning's Trainer") from None
    except (MisconfigurationException, ValueError) as error:
        remedy = "" if options.get("accelerator") == "cpu" else "; trainer=cpu does without a graphics card"
        raise UserError(f"trainer: {one_line(error).rstrip('.!')}{remedy}") from None


PixelArray = NDArray[np.uint8]
"""Height, width, 3; sRGB levels."""

EXTRAS = {"csv": "", "tensorboard": "tracking", "wandb": "wandb", "mlflow": "mlflow"}
"""The names of loggers, and the extra that installs each."""


def make_loggers(names: Sequence[str], out: Path, name: str = "run") -> list[Logger]:
    """The loggers of these names, keys of :data:`EXTRAS`, and always ``csv``; a resumed run adds a version."""
    makers: Mapping[str, Callable[[], Logger]] = {
        "csv": lambda: CSVLogger(out, name="log", flush_logs_every_n_steps=20),
        "tensorboard": lambda: TensorBoardLogger(out, name="tensorboard"),
        "wandb": lambda: WandbLogger(name=name, project="anystyle", save_dir=out),
        "mlflow": lambda: MLFlowLogger(experiment_name="anystyle", run_name=name),
    }
    loggers = []
    for each in dict.fromkeys(["csv", *names]):
        if each not in makers:
            raise UserError(f"loggers: {unknown('logger', each, EXTRAS)}")
        try:
            loggers.append(makers[each]())
        except ModuleNotFoundError as error:
            raise ImportError(f'loggers: {each} is not installed; pip install "anystyle[{EXTRAS[each]}]"') from error
    return loggers


def log_picture(logger: Logger, tag: str, picture: PixelArray, step: int) -> None:
    """Log a picture under a tag at a step; tables take none."""
    if isinstance(logger, TensorBoardLogger):
        logger.experiment.add_image(tag, picture, step, dataformats="HWC")
    elif isinstance(logger, WandbLogger):
        logger.log_image(key=tag, images=[picture], step=step)
    elif isinstance(logger, MLFlowLogger):
        logger.experiment.log_image(logger.run_id, picture, key=tag, step=step)
