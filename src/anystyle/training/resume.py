"""Resuming a run: one at a time in a folder, and with the configuration it began with."""

import json
import logging
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import msgspec
from omegaconf import DictConfig, OmegaConf

from anystyle.documents import Count, read_json
from anystyle.documents import plain as as_json
from anystyle.errors import UserError
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import folder_lock, write_json
from anystyle.registry.compose import changes, flat

UNBOUND = (
    "resume", "checkpoint", "loggers", "workers", "export", "out", "fast_dev_run", "name", "features", "explosion",
    "precision",
)  # fmt: skip
"""Parts of a configuration that may change between the two halves of a run: they do not change its result."""


RECORD = "bound.json"
"""The file of a run's configuration."""
_STATE = "state of a training"
log = logging.getLogger(__name__)


class _State(msgspec.Struct):
    """The part of a checkpoint that every training's has."""

    global_step: Count
    state_dict: dict[str, Any]
    optimizer_states: list[Any]
    loops: dict[str, Any]


_WHAT = "record of a run's configuration; pass resume=changed, resume=never, or another name=..."


def leads() -> bool:
    """Whether this process is of rank 0."""
    return all(os.environ.get(name, "0") == "0" for name in ("RANK", "LOCAL_RANK", "NODE_RANK", "SLURM_PROCID"))


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Keep other runs out of a folder until this one ends, however it ends.

    Raises:
        ValueError: Another run is in it.
    """
    # The processes of one distributed run share its folder.
    refusal = f"another run is at work in {out}; wait for its end, or choose another name=..."
    with folder_lock(out, refusal) if leads() else nullcontext():
        yield


def bound(config: DictConfig) -> dict[str, Any]:
    """The part of a configuration that a continued run must share, as plain values by their full keys."""
    plain = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(plain, dict)
    return json.loads(json.dumps(as_json(flat({key: value for key, value in plain.items() if key not in UNBOUND}))))


def resumable(config: DictConfig, last: Path) -> Path | None:
    """The state to continue from: the last checkpoint, or where that is damaged the one before; nothing is written.

    Raises:
        ValueError: There is one, of another configuration or of one that is not known; or all are damaged.
    """
    if config.resume == "never" or not any(path.is_file() for path in (last, before(last))):
        return None
    record = last.with_name(RECORD)
    current = bound(config)
    if not record.is_file() and config.resume != "changed":
        raise ValueError(
            f"{last.parent} holds a checkpoint and no {record.name} that says of which configuration; "
            f"pass resume=changed to continue it all the same, resume=never to start again, or another name=..."
        )
    previous: dict[str, Any] = read_json(record, dict[str, Any], what=_WHAT) if record.is_file() else current
    changed = changes(previous, current)
    if changed and config.resume != "changed":
        raise ValueError(
            f"{last.parent} holds a run of another configuration ({changed}); pass resume=changed to continue it so, "
            f"resume=never to start again, or another name=..."
        )
    return _whole(last)


def before(last: Path) -> Path:
    """Where the checkpoint before the last one is kept."""
    return last.with_name(f"previous{last.suffix}")


def _whole(last: Path) -> Path:
    """The latest state that is no torn one."""
    problems: list[str] = []
    for path in (last, before(last)):
        if not path.is_file():
            continue
        try:
            msgspec.convert(read_tensors(path, what=_STATE), _State)
        except ValueError as error:
            problems.append(str(error) if isinstance(error, UserError) else f"{path} is no {_STATE} ({error})")
            continue
        for problem in problems:
            log.warning("%s; the run goes on from %s, the one before it", problem, path.name)
        return path
    raise ValueError(f"{'; '.join(problems)}; pass resume=never to start again, or another name=...")


def record(config: DictConfig, last: Path) -> None:
    """Write down the configuration of a run that is about to begin."""
    write_json(last.with_name(RECORD), bound(config))


def sweep(last: Path) -> None:
    """Remove what a run that was killed while it wrote a checkpoint left half-written."""
    if leads():
        for partial in last.parent.glob(f".{last.stem}-*{last.suffix}"):
            partial.unlink(missing_ok=True)


@contextmanager
def trial(config: DictConfig, out: Path) -> Iterator[tuple[DictConfig, Path]]:
    """A run of two steps with everything on, in a folder that is gone afterwards.

    Validation, checkpoint, every logger and the grid of renders take part; nothing is continued and nothing is left.
    """
    short = OmegaConf.merge(
        config,
        {
            "fast_dev_run": False,
            "resume": "never",
            "validation_steps": min(1, config.validation_steps),
            "checkpoint": {"every_steps": 1},
            "trainer": {"max_steps": 2, "val_check_interval": 1, "log_every_n_steps": 1},
        },
    )
    assert isinstance(short, DictConfig)
    if "preview_every" in short.training:
        OmegaConf.update(short, "training.preview_every", 1)
    if "examples" in short.training:
        OmegaConf.update(short, "training.examples", min(16, short.training.examples))
    folder = out / ".trial"
    if leads():
        shutil.rmtree(folder, ignore_errors=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield short, folder
    finally:
        if leads():
            shutil.rmtree(folder, ignore_errors=True)
