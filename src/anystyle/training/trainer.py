"""Lightning's trainer with everything that no run goes without."""

import sys
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import LearningRateMonitor, ThroughputMonitor
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import one_line
from anystyle.training.callbacks import ProgressLines, StepSeed
from anystyle.training.loggers import make_loggers
from anystyle.training.monitors import SkippedData, num_images
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
