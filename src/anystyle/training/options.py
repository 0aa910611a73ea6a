"""Checks of a run's options, before anything is built or written."""

from collections.abc import Callable, Mapping
from typing import Any

from omegaconf import DictConfig, OmegaConf

from anystyle.training.optim import check_rates

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
