"""A training whose trained modules are divided over processes by FSDP2, as Lightning runs it on any device."""

import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import lightning.pytorch as pl
import torch
from lightning.pytorch.strategies import ModelParallelStrategy
from torch.distributed.fsdp import fully_shard
from torch.distributed.tensor import DTensor

from anystyle.training.callbacks import StepSeed
from anystyle.training.run import make_data, make_training
from tests.support.training_cases import configuration


class Divided:
    """Mixed into a training: a process holds its part of each parameter, and the whole while it is used."""

    def configure_model(self) -> None:
        for part in self.exports().values():
            fully_shard(part, mesh=self.device_mesh["data_parallel"])


def steps(words: Sequence[str], out: Path, rank: int = 0, places: dict[str, str] | None = None, world: int = 1) -> None:
    """Train, and save the weights and the share of them that this process holds, in ``out/RANK.pt``."""
    os.environ |= {**(places or {}), "RANK": str(rank), "LOCAL_RANK": str(rank)} if world > 1 else {}
    warnings.simplefilter("ignore")
    config = configuration(words, out)
    torch.manual_seed(config.seed)
    training = make_training(config)
    if world > 1:
        training.__class__ = type("DividedTraining", (Divided, type(training)), {})
    divided = ModelParallelStrategy(data_parallel_size=world, tensor_parallel_size=1, process_group_backend="gloo")
    quiet = dict.fromkeys(("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary"), False)
    trainer = pl.Trainer(
        accelerator="cpu", devices=world, strategy=divided if world > 1 else "auto", max_epochs=-1,
        max_steps=config.trainer.max_steps, gradient_clip_val=0.5, use_distributed_sampler=False,
        check_val_every_n_epoch=None, limit_val_batches=0, callbacks=[StepSeed(config.seed)], **quiet,
    )  # fmt: skip
    trainer.fit(training, datamodule=make_data(config, training))
    state = {key: value for part in training.exports().values() for key, value in part.state_dict().items()}
    held = sum(value.to_local().numel() if isinstance(value, DTensor) else value.numel() for value in state.values())
    whole = {key: value.full_tensor() if isinstance(value, DTensor) else value for key, value in state.items()}
    total = sum(value.numel() for value in whole.values())
    out.mkdir(parents=True, exist_ok=True)
    torch.save({"weights": whole, "held": held / total}, out / f"{rank}.pt")
