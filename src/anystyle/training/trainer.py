"""The Lightning trainer of a configuration: the ranges of its options, its callbacks and its loggers."""

import logging
import sys
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import lightning.pytorch as pl
import numpy as np
from lightning.fabric.plugins.environments.slurm import SLURMEnvironment
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import DeviceStatsMonitor, LearningRateMonitor
from lightning.pytorch.loggers import CSVLogger, Logger, MLFlowLogger, TensorBoardLogger, WandbLogger
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import MissingExtra, UserError, one_line, unknown
from anystyle.ranges import AtLeastOne, Count, NonNegative, Positive, Range
from anystyle.registry.schema import check, option
from anystyle.training.callbacks import ProgressLines, StepSeed, StepThroughput, StepTimer
from anystyle.training.safeguards import FiniteLoss, SkipOutliers
from anystyle.training.watching import EarlyStop


def _or_none(hint: Any) -> Any:
    return hint | None


RANGES: Mapping[str, Any] = {
    "seed": Annotated[int, Range(ge=0, le=(1 << 63) - 1)],
    "workers": Annotated[int, Range(ge=0, le=256, description="0 reads in the training's own process")],
    "validation_steps": Count,
    "checkpoint.every_steps": AtLeastOne,
    "checkpoint.every_minutes": Positive,
    "checkpoint.best": _or_none(Annotated[str, Range(description="a logged value such as val/loss, or null")]),
    "checkpoint.mode": Literal["min", "max"],
    "average": _or_none(Annotated[float, Range(gt=0, lt=1, description="a decay such as 0.999, or null")]),
    "explosion": _or_none(Annotated[float, Range(gt=1, description="a factor such as 1000, or null: never")]),
    "resume": Literal["auto", "never", "changed"],
    "loggers": Annotated[list[str], Range(description="such as loggers=[tensorboard]")],
    "trainer.max_time": _or_none(Annotated[str, Range(description="days and time as DD:HH:MM:SS")]),
    "trainer.profiler": _or_none(Annotated[str, Range(description="simple, advanced or pytorch")]),
    "trainer.deterministic": bool | Literal["warn"] | None,
    "trainer.gradient_clip_val": _or_none(NonNegative),
    "trainer.accumulate_grad_batches": _or_none(AtLeastOne),
    **dict.fromkeys(("fast_dev_run", "skip_outliers", "export.half"), bool),
    **{f"trainer.{name}": AtLeastOne for name in ("max_steps", "log_every_n_steps", "val_check_interval", "num_nodes")},
}
"""Type and range of options that no constructor declares."""


_OURS = (
    "barebones", "callbacks", "check_val_every_n_epoch", "default_root_dir", "enable_checkpointing", "logger",
    "limit_train_batches", "max_epochs", "min_epochs", "overfit_batches", "plugins", "use_distributed_sampler",
    "reload_dataloaders_every_n_epochs",
)  # fmt: skip
_HINTS = typing.get_type_hints(pl.Trainer.__init__)
TrainerOptions = make_dataclass(
    "TrainerOptions",
    [(name, option(_HINTS[name] | None), field(default=None)) for name in _HINTS if name not in (*_OURS, "return")],
)
"""The arguments of Lightning's Trainer but those that a run sets itself; ``None`` leaves each to Lightning."""


def check_options(config: DictConfig) -> None:
    """Check the options of the run and those of the trainer, as ``conf/train.yaml`` composes them."""
    for key, hint in RANGES.items():
        value = OmegaConf.select(config, key, default=None)
        try:
            check(OmegaConf.to_container(value) if OmegaConf.is_config(value) else value, hint)
        except ValueError as error:
            raise UserError(f"{key}={value}: {error}") from None
    trainer, precision = config.trainer, str(config.trainer.precision)
    if precision == "64" or precision.endswith(("16-true", "64-true")):
        raise UserError(f"trainer.precision={precision}: weights have single precision; use bf16-mixed or 32-true")
    if trainer.accelerator == "cpu" and precision.startswith("16"):
        raise UserError(f"trainer.precision={precision} needs a graphics card; use bf16-mixed or 32-true")
    batches = trainer.max_steps * (trainer.accumulate_grad_batches or 1)
    validated = config.validation_steps and any(map(config.get, ("validation_scenes", "validation_styles")))
    if validated and trainer.val_check_interval > batches:
        told = "trainer.val_check_interval=%d: the run has %d batches and is never validated"
        logging.getLogger(__name__).warning(told, trainer.val_check_interval, batches)


def make_trainer(config: DictConfig, out: Path, guard: FiniteLoss, callbacks: list[pl.Callback]) -> pl.Trainer:
    """Build the trainer of a run; ``config.trainer`` holds options of Lightning's.

    ``guard`` comes ahead of what scales gradients, so that it sees their own norm.
    """
    values: Any = OmegaConf.to_container(config.trainer, resolve=True)
    options = {"num_sanity_val_steps": 0, "enable_model_summary": False, "enable_progress_bar": sys.stderr.isatty()}
    options |= {name: value for name, value in values.items() if value is not None}
    common: list[pl.Callback] = [
        StepSeed(config.seed),
        guard,
        LearningRateMonitor(),
        StepThroughput(lambda batch: getattr(batch, "num_images", 1), window_size=20),
        *([SkipOutliers()] if config.skip_outliers else []),
        *([] if options["enable_progress_bar"] else [ProgressLines()]),
    ]
    max_time = options.pop("max_time", None)
    try:
        timer = [] if max_time is None else [StepTimer(max_time)]
        return pl.Trainer(
            **options,
            # Lightning would resume from files of its own there, whatever the run was asked for; and requeue by itself.
            default_root_dir=out / "log",
            plugins=SLURMEnvironment(auto_requeue=False) if SLURMEnvironment.detect() else None,
            max_epochs=-1,
            check_val_every_n_epoch=None,
            use_distributed_sampler=False,
            enable_checkpointing=False,
            logger=make_loggers(list(config.loggers), out, str(config.name)),
            callbacks=[*common, *timer, *make_callbacks(config.get("callbacks") or {}), *callbacks],
        )
    except UserError:
        raise
    except TypeError as error:
        raise UserError(f"trainer: {error}; the options are those of lightning's Trainer") from None
    except (MisconfigurationException, ValueError, ModuleNotFoundError) as error:
        remedy = "" if options.get("accelerator") == "cpu" else "; trainer=cpu does without a graphics card"
        raise UserError(f"trainer: {one_line(error).rstrip('.!')}{remedy}") from None


CALLBACKS = {"early_stopping": EarlyStop, "device_stats_monitor": DeviceStatsMonitor}
"""Lightning's callbacks by the names that ``conf/callbacks`` has, too."""


def make_callbacks(given: Mapping[str, Any]) -> list[pl.Callback]:
    """The callbacks of a configuration: the options of each by its name, a key of :data:`CALLBACKS`."""
    if strange := [name for name in given if name not in CALLBACKS]:
        raise UserError(f"callbacks: {unknown('callback', strange[0], CALLBACKS)}")
    return [CALLBACKS[name](**(options or {})) for name, options in given.items()]


PACKAGES = {"csv": "", "tensorboard": "tensorboard", "wandb": "wandb", "mlflow": "mlflow-skinny"}
"""The names of loggers, and the package that each needs."""


def make_loggers(names: Sequence[str], out: Path, name: str = "run") -> list[Logger]:
    """The loggers of these names, keys of :data:`PACKAGES`, and always ``csv``; a resumed run adds a version."""
    makers: Mapping[str, Callable[[], Logger]] = {
        "csv": lambda: CSVLogger(out, name="log", flush_logs_every_n_steps=20),
        "tensorboard": lambda: TensorBoardLogger(out, name="tensorboard"),
        "wandb": lambda: WandbLogger(name=name, project="anystyle", save_dir=out),
        "mlflow": lambda: MLFlowLogger(experiment_name="anystyle", run_name=name),
    }
    loggers = []
    for each in dict.fromkeys(["csv", *names]):
        if each not in makers:
            raise UserError(f"loggers: {unknown('logger', each, PACKAGES)}")
        try:
            loggers.append(makers[each]())
        except ModuleNotFoundError as error:
            raise MissingExtra(f"loggers: {each} is not installed: pip install {PACKAGES[each]}") from error
    return loggers


def log_picture(logger: Logger, tag: str, picture: NDArray[np.uint8], step: int) -> None:
    """Log a picture, ``[H, W, 3]`` in levels of sRGB, under a tag at a step; tables take none."""
    if isinstance(logger, TensorBoardLogger):
        logger.experiment.add_image(tag, picture, step, dataformats="HWC")
    elif isinstance(logger, WandbLogger):
        logger.log_image(key=tag, images=[picture], step=step)
    elif isinstance(logger, MLFlowLogger):
        logger.experiment.log_image(logger.run_id, picture, key=tag, step=step)
