"""Resuming a run: one process at a time in its folder, and with the configuration that it began with."""

import json
import logging
import os
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import UserError
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import folder_lock
from anystyle.io.documents import plain
from anystyle.io.run_folder import RECORD, flat, refuse_changes, without
from anystyle.ranges import Count

UNBOUND = (
    "resume", "checkpoint", "loggers", "workers", "export", "out", "fast_dev_run", "name", "explosion", "precision",
    "cache", "objective", "trainer.max_time", "trainer.log_every_n_steps", "trainer.profiler",
    "trainer.enable_progress_bar", "trainer.enable_model_summary",
)  # fmt: skip
"""Parts of a configuration that may change when a run is resumed: they do not change its result."""
log = logging.getLogger(__name__)


class _Checkpoint(msgspec.Struct):
    """The part of a checkpoint that every training's has."""

    global_step: Count
    state_dict: dict[str, Any]
    optimizer_states: list[Any]
    loops: dict[str, Any]


class Resumed(NamedTuple):
    """The checkpoint that a run is resumed from, and its optimizer steps."""

    path: Path
    step: int


def is_rank_zero() -> bool:
    """Whether this process is of rank 0; known before a trainer is."""
    return all(os.environ.get(name, "0") == "0" for name in ("RANK", "LOCAL_RANK", "NODE_RANK", "SLURM_PROCID"))


def exclusive(out: Path) -> AbstractContextManager[Callable[[], None]]:
    """Keep other runs out of a folder, which the processes of one distributed run share.

    The block is given a function that raises an error if another run has come in all the same.
    """
    refusal = f"another run is at work in {out}; wait for its end, or choose another name=..."
    return folder_lock(out, refusal) if is_rank_zero() else nullcontext(lambda: None)


def bound(config: DictConfig) -> dict[str, Any]:
    """The part of a configuration that a resumed run must share, as plain values by their full keys."""
    values: Any = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    return json.loads(json.dumps(plain(without(flat(values), UNBOUND))))


def resumable(config: DictConfig, last: Path) -> Resumed | None:
    """The checkpoint to resume from: the last one, or where that is damaged the one before."""
    paths = [path for path in (last, previous(last)) if path.is_file()]
    if config.resume == "never" or not paths:
        return None
    if config.resume != "changed":
        remedy = "pass resume=changed to resume it all the same, resume=never to start again, or another name=..."
        if not refuse_changes(last.parent, bound(config), "a run", remedy, UNBOUND):
            raise UserError(f"{last.parent} holds a checkpoint and no {RECORD} with its configuration; {remedy}")
    problems: list[str] = []
    for path in paths:
        try:
            checkpoint = msgspec.convert(read_tensors(path, what="checkpoint of a training"), _Checkpoint)
        except ValueError as error:
            known = isinstance(error, UserError)
            problems.append(str(error) if known else f"{path} is not a checkpoint of a training ({error})")
            continue
        for problem in problems:
            log.warning("%s; resuming from %s, the one before it", problem, path.name)
        return Resumed(path, checkpoint.global_step)
    raise UserError(f"{'; '.join(problems)}; pass resume=never to start again, or another name=...")


def previous(last: Path) -> Path:
    """Where the checkpoint before the last one is kept."""
    return last.with_name(f"previous{last.suffix}")
