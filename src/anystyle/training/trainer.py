"""The trainer of a configuration: what its options may be, and its loggers."""

import sys
from collections.abc import Callable, Mapping, Sequence
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
from anystyle.training.optim import check_rates
from anystyle.training.safeguards import FiniteLoss, SkipOutliers
from anystyle.training.sharding import Sharded

RESERVED = (
    "default_root_dir", "max_epochs", "check_val_every_n_epoch", "num_sanity_val_steps", "use_distributed_sampler",
    "enable_checkpointing", "enable_model_summary", "enable_progress_bar", "callbacks", "logger",
)  # fmt: skip
"""Options of Lightning's trainer that a run sets itself."""

SHARDED = "fsdp2"
"""The strategy that shards trainable weights over the processes."""


def check_options(config: DictConfig) -> None:
    """Check the options of the run and those of the trainer, as ``conf/train.yaml`` composes them.

    Raises:
        ValueError: One is out of its range, or some contradict each other.
    """
    for key, (holds, expected) in RANGES.items():
        value = OmegaConf.select(config, key)
        if not _holds(holds, value):
            raise ValueError(f"{key}={value}: {expected}")
    rates = {str(name): value for name, value in config.training.items() if str(name).endswith("rate")}
    check_rates(**{name: rate for name, rate in rates.items() if isinstance(rate, (int, float))})
    plain = OmegaConf.to_container(config.trainer, resolve=True)
    assert isinstance(plain, dict)
    check_trainer({str(name): value for name, value in plain.items()}, average=config.average is not None)


def _at_least(least: int) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and value >= least


def _between(low: float, high: float) -> Callable[[Any], bool]:
    return lambda value: value is None or low < float(value) < high


RANGES: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "seed": (lambda value: isinstance(value, int) and 0 <= value < 1 << 63, "give a whole number, at least 0"),
    "workers": (_at_least(0), "give a number of processes, 0 to read in the training's own"),
    "validation_steps": (_at_least(0), "give a number of steps, 0 for no validation"),
    "checkpoint.every_steps": (_at_least(1), "give a number of steps, at least 1"),
    "checkpoint.every_minutes": (_between(0.0, float("inf")), "give minutes above 0"),
    "average": (_between(0.0, 1.0), "the average's decay is between 0 and 1, such as 0.999; null keeps none"),
    "explosion": (
        _between(1.0, float("inf")), "a loss may vary; give a factor above 1, such as 1000, or null to let it grow"
    ),
    "resume": (lambda value: value in ("auto", "never", "changed"), "choose from auto, never, changed"),
    "loggers": (lambda value: OmegaConf.is_list(value), "give a list, such as loggers=[tensorboard]"),
    "fast_dev_run": (lambda value: isinstance(value, bool), "choose from true, false"),
    "skip_outliers": (lambda value: isinstance(value, bool), "choose from true, false"),
    "export.half": (lambda value: isinstance(value, bool), "choose from true, false"),
}  # fmt: skip
"""For each option of a run the test of a value, and what is expected."""


def _holds(holds: Callable[[Any], bool], value: Any) -> bool:
    try:
        return holds(value)
    except (TypeError, ValueError):  # no number at all
        return False


def check_trainer(options: Mapping[str, Any], *, average: bool) -> None:
    """Refuse options of Lightning's trainer that it accepts and that break a run.

    Raises:
        ValueError: Some are out of range or contradict each other.
    """
    for name in RESERVED:
        if name in options:
            raise ValueError(f"trainer.{name}={options[name]}: a run sets that itself; leave it out")
    steps, precision = options.get("max_steps"), str(options.get("precision"))
    if not _at_least(1)(steps):
        raise ValueError(f"trainer.max_steps={steps}: the schedule needs an end; give at least 1")
    for name in ("log_every_n_steps", "val_check_interval", "accumulate_grad_batches", "num_nodes"):
        if name in options and not _at_least(1)(options[name]):
            raise ValueError(f"trainer.{name}={options[name]}: give a whole number, at least 1")
    clip = options.get("gradient_clip_val")
    if clip is not None and not _holds(lambda value: float(value) >= 0, clip):
        raise ValueError(f"trainer.gradient_clip_val={clip}: give a norm, or null to clip nothing")
    if options.get("deterministic") is True and options.get("benchmark"):
        raise ValueError(
            "trainer.deterministic=true and trainer.benchmark=true: benchmarking picks kernels by their speed, "
            "which is not the same twice; leave one of them out"
        )
    if options.get("accelerator") == "cpu" and precision.startswith("16"):
        raise ValueError(
            f"trainer.precision={precision} on trainer.accelerator=cpu: half precision needs a graphics card; use "
            f"bf16-mixed or 32-true"
        )
    if options.get("strategy") == SHARDED and average:
        raise ValueError(
            "trainer.strategy=fsdp2 with average=...: an average needs all weights in each process; use trainer=ddp or "
            "average=null"
        )
    if options.get("strategy") == SHARDED and precision.startswith("16"):
        raise ValueError(f"trainer.strategy=fsdp2 with trainer.precision={precision}: use bf16-mixed or 32-true")


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
