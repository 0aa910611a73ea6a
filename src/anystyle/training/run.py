"""One run of a training: built, continued from its checkpoint, and its weights exported at the end."""

import os
import shlex
import subprocess
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from torch import nn

from anystyle.contracts import Backbone, Loss, Renderer, SceneSource, StyleEncoder, StyleSource
from anystyle.documents import Figure, as_number, kept_json
from anystyle.errors import one_line
from anystyle.inference.assemble import assemble, branch_header, room_for_backbone, weights_file
from anystyle.io.arrays import read_tensors
from anystyle.io.atomic import write_json
from anystyle.io.checkpoint import Header, load_part, save_part, sha256
from anystyle.paths import SHARED
from anystyle.registry.build import build, build_all
from anystyle.registry.catalog import catalog
from anystyle.registry.schema import runtime_arguments
from anystyle.training.cache import CachedScenes
from anystyle.training.callbacks import Average, LastCheckpoint, logged
from anystyle.training.contract import Training
from anystyle.training.data import StepData
from anystyle.training.resume import alone, leads, record, resumable, sweep, trial
from anystyle.training.scene_cache import FeatureFolder
from anystyle.training.sharding import with_full_state
from anystyle.training.trainer import check_options, make_trainer

METRICS = "metrics.json"
FEATURES = "features"
"""The ``cache`` that keeps encoded scenes; any other name is a folder of scenes as they were made or decoded."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run.

    Args:
        steps: Optimizer steps in all.
        finished: Whether it came to its end, rather than being stopped.
        metrics: The last values logged.
        weights: The files of exported weights.
        leading: Whether this process is of rank 0, which writes and prints.
        stopped_by: The signal that ended it, if one did.
    """

    steps: int
    finished: bool
    metrics: Mapping[str, float]
    weights: tuple[Path, ...]
    leading: bool = True
    stopped_by: str | None = None


def train(config: DictConfig, out: Path, on_begin: Callable[[], None] = lambda: None) -> Outcome:
    """Run a training, or what is left of it.

    Args:
        config: As ``conf/train.yaml`` composes it.
        out: Folder of checkpoints, logs and weights; a run is continued from the checkpoint there.
        on_begin: Called once all is checked and built, before the first step.

    Raises:
        ValueError: The configuration contradicts itself or is not that of the run to be continued, or another run is
            at work there.
    """
    check_options(config)
    with alone(out):
        if not config.fast_dev_run:
            return _train(config, out, on_begin)
        with trial(config, out) as (short, folder):
            outcome = _train(short, folder, lambda: None)
        return replace(outcome, weights=())


def _train(config: DictConfig, out: Path, on_begin: Callable[[], None]) -> Outcome:
    # At once: the checkout may move on while a run goes on with what it was begun with.
    provenance = provenance_of(config)
    last = out / "last.ckpt"
    sweep(last)
    state = resumable(config, last)
    if state is not None and (ended := _ended(config, out, state)) is not None:
        return ended
    # Trainer and data come first: a mistake in them shows before networks are loaded, which may take minutes.
    average = Average(float(config.average)) if config.average else None
    keeper = LastCheckpoint(
        last, every_steps=config.checkpoint.every_steps, every_minutes=float(config.checkpoint.every_minutes)
    )
    trainer = make_trainer(config, out, [*([average] if average else []), keeper])
    sources = make_sources(config)
    torch.manual_seed(config.seed)
    training = make_training(config)
    data = make_data(config, training, sources)
    if leads():
        record(config, last)
        on_begin()
    with warnings.catch_warnings():
        # Lightning advises on choices that are made on purpose here.
        warnings.filterwarnings("ignore", module=r"lightning\..*")
        warnings.filterwarnings("ignore", message=".*LeafSpec.*")
        warnings.filterwarnings("ignore", message="This DataLoader will create .* worker processes")
        # The attributes of a branch are views of one tensor; nothing writes into them.
        warnings.filterwarnings("ignore", message="FSDP2-wrapped module .* returned a view")
        try:
            trainer.fit(training, datamodule=data, ckpt_path=state, weights_only=state is not None or None)
        except (RuntimeError, KeyError, TypeError, AttributeError) as error:
            if state is None or keeper.started:
                raise
            raise ValueError(f"{state} is no state of this training ({one_line(error)[:300]})") from error
    finished = trainer.global_step >= trainer.max_steps
    metrics = keeper.metrics | logged(trainer)
    weights: tuple[Path, ...] = ()
    if finished and average:
        average.swap(training)
    exports = {part: with_full_state(module) for part, module in training.exports().items()} if finished else {}
    if trainer.is_global_zero and finished:
        weights = export(config, exports, out, provenance={**provenance, "steps": trainer.global_step})
        write_json(out / METRICS, dict(sorted(metrics.items())))
    return Outcome(trainer.global_step, finished, metrics, weights, trainer.is_global_zero, keeper.stopped_by)


def _ended(config: DictConfig, out: Path, state: Path) -> Outcome | None:
    """The outcome of a run that came to its end and left everything; ``None`` for any other."""
    stored = read_tensors(state)
    kept: dict[str, Figure] | None = kept_json(out / METRICS, dict[str, Figure])
    weights = tuple(sorted(out.glob("*.safetensors")))
    if stored["global_step"] < config.trainer.max_steps or kept is None or not weights or config.resume == "changed":
        return None
    return Outcome(
        stored["global_step"], True, {name: as_number(value) for name, value in kept.items()}, weights, leads()
    )


def make_training(config: DictConfig) -> Training:
    """Build the training and the parts that it names.

    Raises:
        ValueError: Features are to be kept for a training that changes what makes them.
    """
    plugin = catalog().owner("training", str(config.training.get("_target_")))
    named = runtime_arguments(plugin)
    parts: dict[str, Any] = {}
    makers: dict[str, Callable[[], Any]] = {
        "stylizer": lambda: assemble(config, learns=True)[0],
        "backbone": lambda: _learning_backbone(config),
        "style_encoder": lambda: _weighted(config, "style_encoder", build(StyleEncoder, config.style_encoder)),
        "renderer": lambda: build(Renderer, config.renderer),
        "losses": lambda: build_all(
            Loss, objective(config), style_encoder=parts["stylizer"].style_encoder if "stylizer" in parts else None
        ),
    }
    if config.get("cache") == FEATURES:
        if "features" not in named:
            raise ValueError(f"cache=features is for trainings on a frozen backbone, and {plugin.name} is none")
        makers["features"] = lambda: _features(config)
    for name, make in makers.items():
        if name in named:
            parts[name] = make()
    return build(Training, config.training, **parts)


def _features(config: DictConfig) -> FeatureFolder:
    """Where encoded scenes are kept, and all of the configuration that they depend on."""
    weights = config.weights.get("backbone")
    parts = OmegaConf.to_container(
        OmegaConf.masked_copy(config, ["backbone", "scenes"]), resolve=True, enum_to_str=True
    )
    assert isinstance(parts, dict)
    description = {
        **{str(key): value for key, value in parts.items()},
        "weights": None if weights is None else sha256(weights_file(weights)),
        # Weights as initialised are a function of the seed.
        "seed": config.seed,
        "precision": str(config.trainer.precision),
        "accelerator": str(config.trainer.accelerator),
        "torch": torch.__version__,
    }
    return FeatureFolder(Path(str(config.features.folder)).expanduser(), float(config.features.gigabytes), description)


def objective(config: DictConfig) -> dict[str, Any]:
    """The terms of the objective, by name: those configured, but for those that an ablation leaves out.

    Raises:
        PluginError: What is left out is no loss.
    """
    # One name needs no brackets, so that a sweep may leave out one term a job: `without=style,content`.
    without = [config.without] if isinstance(config.without, str) else list(config.without)
    for name in without:
        catalog().find("loss", name)
    return {name: node for name, node in (config.loss or {}).items() if name not in without}


def _learning_backbone(config: DictConfig) -> nn.Module:
    room_for_backbone(config, learns=True)
    return _weighted(config, "backbone", build(Backbone, config.backbone))


def _weighted(config: DictConfig, part: str, module: nn.Module) -> nn.Module:
    name = config.weights.get(part)
    if name is not None:
        load_part(weights_file(name), module, part)
    return module


@dataclass(frozen=True)
class Sources:
    """The scenes and styles of a run, where it has some."""

    scenes: SceneSource | None
    styles: StyleSource | None
    validation_scenes: SceneSource | None
    validation_styles: StyleSource | None


def make_sources(config: DictConfig) -> Sources:
    """Build the scenes and styles that a configuration names."""
    return Sources(
        scenes=_scenes(config, "scenes"),
        styles=_styles(config, "styles"),
        validation_scenes=_scenes(config, "validation_scenes"),
        validation_styles=_styles(config, "validation_styles"),
    )


def make_data(config: DictConfig, training: Training, sources: Sources | None = None) -> StepData:
    """The data module of training and validation batches; by default of the sources of the configuration."""
    sources = sources or make_sources(config)
    validated = sources.validation_scenes is not None or sources.validation_styles is not None
    validation = None
    if validated and config.validation_steps:
        # First, because a training keeps the seed of its last call.
        styles = sources.validation_styles or sources.styles
        validation = training.batches(sources.validation_scenes, styles, seed=config.seed + 1)
    source = training.batches(sources.scenes, sources.styles, seed=config.seed)
    return StepData(source, validation, validation_steps=config.validation_steps, workers=config.workers)


def _chosen(config: DictConfig, key: str) -> bool:
    """Whether a group has a choice; where it was taken back, an experiment's options for it may be left."""
    return config.get(key) is not None and config[key].get("_target_") is not None


def _scenes(config: DictConfig, key: str) -> SceneSource | None:
    if not _chosen(config, key):
        return None
    source = build(SceneSource, config[key])
    cache = config.get("cache")
    return source if cache in (None, FEATURES) else CachedScenes(source, Path(str(cache)).expanduser() / key)


def _styles(config: DictConfig, key: str) -> StyleSource | None:
    return build(StyleSource, config[key]) if _chosen(config, key) else None


def export(
    config: DictConfig, exports: Mapping[str, nn.Module], out: Path, *, provenance: Mapping[str, Any]
) -> tuple[Path, ...]:
    """Write the exports of a training as weights files, with their provenance.

    Raises:
        OSError: They cannot be written; the checkpoint stays, and the same command writes them once there is room.
    """
    written = []
    for part, module in exports.items():
        if part == "branch":
            header = branch_header(config, module, provenance)
        else:
            node = OmegaConf.to_container(config[part], resolve=True, enum_to_str=True) if part in config else {}
            header = Header(part=part, config={part: node}, provenance=dict(provenance))
        path = out / f"{part}.safetensors"
        try:
            save_part(path, module, header, half=config.export.half)
        except OSError as error:
            raise OSError(f"{one_line(error)}; the same command writes it once it can") from None
        written.append(path)
    return tuple(written)


def provenance_of(config: DictConfig) -> dict[str, Any]:
    """Who makes a weights file: the command, the commit and the seed."""
    return {
        "command": shlex.join(["anystyle", "train", *sys.argv[1:]]),
        "commit": commit(),
        "seed": config.seed,
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
