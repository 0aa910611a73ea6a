"""One run of a training: built, continued where it was left, and its weights written at the end."""

import json
import logging
import os
import shlex
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning.pytorch as pl
import torch
from lightning.pytorch.loggers import CSVLogger, Logger
from omegaconf import DictConfig, OmegaConf
from torch import nn

from anystyle.assemble import assemble, branch_header, weights_file
from anystyle.checkpoint import Header, load_part, save_part
from anystyle.contracts import Backbone, Loss, Renderer, SceneSource, StyleEncoder, StyleSource
from anystyle.files import atomic_path
from anystyle.paths import SHARED
from anystyle.registry.build import build, build_all
from anystyle.registry.catalog import catalog
from anystyle.registry.schema import runtime_arguments
from anystyle.training.cache import CachedScenes
from anystyle.training.callbacks import Average, FiniteLoss, LastCheckpoint, Lines, SkipOutliers, StepSeed
from anystyle.training.contract import Training
from anystyle.training.data import StepData

log = logging.getLogger(__name__)

UNBOUND = ("resume", "checkpoint", "loggers", "workers", "export", "out", "fast_dev_run", "name")
"""Parts of a configuration that may change between the two halves of a run: they do not change its result."""


@dataclass(frozen=True)
class Outcome:
    """What a run left behind.

    Args:
        steps: Done in all.
        finished: Whether it came to its end, rather than being stopped.
        metrics: The last values logged.
        weights: The files written.
        leading: Whether this process is the one that writes and speaks.
    """

    steps: int
    finished: bool
    metrics: Mapping[str, float]
    weights: tuple[Path, ...]
    leading: bool = True


def train(config: DictConfig, out: Path) -> Outcome:
    """Run a training, or what is left of it.

    Args:
        config: What ``conf/train.yaml`` composes.
        out: Where checkpoints, logs and weights go; a run is continued from the checkpoint found there.

    Raises:
        ValueError: The configuration contradicts itself or is not that of the run to be continued, or another run is
            at work there.
    """
    out.mkdir(parents=True, exist_ok=True)
    with alone(out):
        return _train(config, out)


def _train(config: DictConfig, out: Path) -> Outcome:
    last = out / "last.ckpt"
    resume = _resumable(config, last)
    torch.manual_seed(config.seed)
    training = make_training(config)
    data = make_data(config, training)
    average = Average(float(config.average)) if config.average else None
    keeper = LastCheckpoint(
        last, every_steps=config.checkpoint.every_steps, every_minutes=float(config.checkpoint.every_minutes)
    )
    # A trial of a step or two leaves nothing behind.
    keepers: list[pl.Callback] = [] if config.fast_dev_run else [keeper]
    trainer = make_trainer(config, out, [*([average] if average else []), *keepers])
    with warnings.catch_warnings():
        # Lightning advises on choices that are made on purpose here.
        warnings.filterwarnings("ignore", module=r"lightning\..*")
        warnings.filterwarnings("ignore", message=".*LeafSpec.*")
        trainer.fit(training, datamodule=data, ckpt_path=str(last) if resume else None, weights_only=resume or None)
    finished = trainer.global_step >= trainer.max_steps
    metrics = {name: float(value) for name, value in trainer.callback_metrics.items()}
    weights: tuple[Path, ...] = ()
    if trainer.is_global_zero and finished and not config.fast_dev_run:
        if average:
            average.swap(training)
        weights = export(config, training, out, steps=trainer.global_step)
        with atomic_path(out / "metrics.json") as temporary:
            temporary.write_text(json.dumps(metrics, indent=2, sort_keys=True) + "\n")
    return Outcome(trainer.global_step, finished, metrics, weights, trainer.is_global_zero)


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Keep other runs out of a folder until this one ends, however it ends.

    Raises:
        ValueError: Another run is in it.
    """
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    # The processes of one distributed run share its folder.
    if os.environ.get("LOCAL_RANK", "0") != "0" or os.environ.get("NODE_RANK", "0") != "0":
        yield
        return
    with (out / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"another run is at work in {out}; wait for its end, or choose another name=...") from None
        yield


def make_training(config: DictConfig) -> Training:
    """Build the training and the parts that it names."""
    plugin = catalog().owner("training", str(config.training.get("_target_")))
    named = runtime_arguments(plugin)
    parts: dict[str, Any] = {}
    makers: dict[str, Callable[[], Any]] = {
        "stylizer": lambda: assemble(config)[0],
        "backbone": lambda: _weighted(config, "backbone", build(Backbone, config.backbone)),
        "style_encoder": lambda: _weighted(config, "style_encoder", build(StyleEncoder, config.style_encoder)),
        "renderer": lambda: build(Renderer, config.renderer),
        "losses": lambda: build_all(
            Loss, objective(config), style_encoder=parts["stylizer"].style_encoder if "stylizer" in parts else None
        ),
    }
    for name, make in makers.items():
        if name in named:
            parts[name] = make()
    return build(Training, config.training, **parts)


def objective(config: DictConfig) -> dict[str, Any]:
    """The terms of the objective, by name: those configured, but for those that an ablation leaves out.

    Raises:
        PluginError: What is left out is no loss.
    """
    for name in config.without:
        catalog().find("loss", name)
    return {name: node for name, node in (config.loss or {}).items() if name not in config.without}


def _weighted(config: DictConfig, part: str, module: nn.Module) -> nn.Module:
    name = config.weights.get(part)
    if name is not None:
        load_part(weights_file(name), module, part)
    return module


def make_data(config: DictConfig, training: Training) -> StepData:
    """What the training reads, and what it is validated on."""
    scenes, validation_scenes = (_scenes(config, key) for key in ("scenes", "validation_scenes"))
    styles, validation_styles = (
        None if config.get(key) is None else build(StyleSource, config[key]) for key in ("styles", "validation_styles")
    )
    validated = validation_scenes is not None or validation_styles is not None
    validation = None
    if validated and config.validation_steps:
        # Asked for first, so that the training's own seed is the last one it hears.
        validation = training.batches(validation_scenes, validation_styles or styles, seed=config.seed + 1)
    source = training.batches(scenes, styles, seed=config.seed)
    return StepData(source, validation, validation_steps=config.validation_steps, workers=config.workers)


def _scenes(config: DictConfig, key: str) -> SceneSource | None:
    if config.get(key) is None:
        return None
    source = build(SceneSource, config[key])
    cache = config.get("cache")
    return source if cache is None else CachedScenes(source, Path(str(cache)).expanduser() / key)


def make_trainer(config: DictConfig, out: Path, callbacks: list[pl.Callback]) -> pl.Trainer:
    """Lightning's trainer with everything that no run goes without."""
    options = OmegaConf.to_container(config.trainer, resolve=True)
    assert isinstance(options, dict)
    terminal = sys.stderr.isatty()
    guards: list[pl.Callback] = [StepSeed(config.seed), FiniteLoss(out / "refused_batch.pt")]
    if config.skip_outliers:
        guards.append(SkipOutliers())
    if not terminal:
        guards.append(Lines())
    try:
        return pl.Trainer(
            **{str(key): value for key, value in options.items()},
            default_root_dir=out,
            max_epochs=-1,
            check_val_every_n_epoch=None,
            num_sanity_val_steps=0,
            use_distributed_sampler=False,
            enable_checkpointing=False,
            enable_model_summary=False,
            enable_progress_bar=terminal,
            logger=make_loggers(list(config.loggers), out),
            callbacks=[*guards, *callbacks],
        )
    except TypeError as error:
        raise ValueError(f"trainer: {error}; the options are those of lightning's Trainer") from None


def make_loggers(names: list[str], out: Path) -> list[Logger]:
    """The loggers of these names; each run of a training that is continued gets a version of its own."""
    return [_logger(name, out) for name in names]


def _logger(name: str, out: Path) -> Logger:
    if name == "csv":
        return CSVLogger(out, name="log", flush_logs_every_n_steps=20)
    if name == "tensorboard":
        try:
            from lightning.pytorch.loggers import TensorBoardLogger

            return TensorBoardLogger(out, name="tensorboard")
        except ModuleNotFoundError:
            raise ValueError('loggers: tensorboard is not installed; pip install "anystyle[tracking]"') from None
    raise ValueError(f"loggers: no logger is named '{name}'; choose from csv, tensorboard")


def bound(config: DictConfig) -> dict[str, Any]:
    """The part of a configuration that a continued run must share, as plain values by their full keys."""
    plain = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    assert isinstance(plain, dict)
    return dict(_flat({key: value for key, value in plain.items() if key not in UNBOUND}))


def _flat(node: Any, prefix: str = "") -> list[tuple[str, Any]]:
    if isinstance(node, dict):
        return [row for key, value in node.items() for row in _flat(value, f"{prefix}.{key}" if prefix else str(key))]
    return [(prefix, node)]


def _resumable(config: DictConfig, last: Path) -> bool:
    """Whether there is a run to continue; writes down the configuration of a new one.

    Raises:
        ValueError: There is one, of another configuration.
    """
    record = last.with_name("bound.json")
    current = json.loads(json.dumps(bound(config)))
    if config.resume != "never" and last.is_file():
        earlier = json.loads(record.read_text()) if record.is_file() else current
        changed = sorted(key for key in {*earlier, *current} if earlier.get(key) != current.get(key))
        if changed and config.resume != "changed":
            shown = ", ".join(f"{key} {earlier.get(key)} -> {current.get(key)}" for key in changed[:5])
            raise ValueError(
                f"{last.parent} holds a run of another configuration ({shown}{', …' if len(changed) > 5 else ''}); "
                f"pass resume=changed to continue it so, resume=never to start again, or another name=..."
            )
        return True
    with atomic_path(record) as temporary:
        temporary.write_text(json.dumps(current, indent=2, sort_keys=True) + "\n")
    return False


def export(config: DictConfig, training: Training, out: Path, *, steps: int) -> tuple[Path, ...]:
    """Write what the training made, as weights files that say how they were made."""
    provenance = provenance_of(config, steps)
    written = []
    for part, module in training.exports().items():
        if part == "branch":
            header = branch_header(config, provenance)
        else:
            node = OmegaConf.to_container(config[part], resolve=True, enum_to_str=True) if part in config else {}
            header = Header(part=part, config={part: node}, provenance=provenance)
        path = out / f"{part}.safetensors"
        save_part(path, module, header, half=config.export.half)
        written.append(path)
    return tuple(written)


def provenance_of(config: DictConfig, steps: int) -> dict[str, Any]:
    """Who made a weights file: the command, the commit, the seed and the steps."""
    return {
        "command": shlex.join(["anystyle", "train", *sys.argv[1:]]),
        "commit": commit(),
        "seed": config.seed,
        "steps": steps,
        "torch": torch.__version__,
    }


def commit() -> str:
    """The commit of the checkout, with ``+`` where files differ from it; empty where there is no checkout."""
    if not (SHARED / ".git").exists():
        return ""
    git = ["git", "-C", os.fspath(SHARED)]
    try:
        head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
        changed = subprocess.run([*git, "diff", "--quiet", "HEAD"], check=False).returncode
    except (OSError, subprocess.CalledProcessError):
        return ""
    return head + ("+" if changed else "")
