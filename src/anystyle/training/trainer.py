"""Lightning's trainer with everything that no run goes without."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
from lightning.fabric.utilities.exceptions import MisconfigurationException
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import one_line
from anystyle.training.callbacks import Lines, StepSeed
from anystyle.training.guards import FiniteLoss, SkipOutliers
from anystyle.training.loggers import make_loggers
from anystyle.training.sharding import Sharded
from anystyle.training.vitals import SkippedData, Vitals

SHARDED = "fsdp2"
"""The strategy by which processes share out the weights that learn."""


def make_trainer(config: DictConfig, out: Path, callbacks: list[pl.Callback]) -> pl.Trainer:
    """Build the trainer of a run.

    Args:
        config: What ``conf/train.yaml`` composes; ``trainer`` holds options of Lightning's Trainer.
        out: Where it writes.
        callbacks: What the run adds.

    Raises:
        ValueError: Options contradict each other, or this machine cannot fulfil them.
    """
    plain = OmegaConf.to_container(config.trainer, resolve=True)
    assert isinstance(plain, dict)
    options: dict[str, Any] = {str(key): value for key, value in plain.items()}
    check(options, average=config.average is not None)
    if options.get("strategy") == SHARDED:
        options["strategy"] = Sharded(save_distributed_checkpoint=False)
    terminal = sys.stderr.isatty()
    guards: list[pl.Callback] = [
        StepSeed(config.seed),
        FiniteLoss(out / "refused_batch.pt", growth=None if config.explosion is None else float(config.explosion)),
        Vitals(),
        SkippedData(out / "skipped.txt"),
    ]
    if config.skip_outliers:
        guards.append(SkipOutliers())
    if not terminal:
        guards.append(Lines())
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
        raise ValueError(f"trainer: {one_line(error)}") from None


def check(options: Mapping[str, Any], *, average: bool) -> None:
    """Refuse options of which each is fine alone.

    Args:
        options: Of ``trainer``.
        average: Whether an average of the weights is kept.

    Raises:
        ValueError: Some contradict each other; the message says which, and what to do.
    """
    steps, precision = options.get("max_steps"), str(options.get("precision"))
    if not isinstance(steps, int) or steps < 1:
        raise ValueError(f"trainer.max_steps={steps}: the schedule needs an end; give at least 1")
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
