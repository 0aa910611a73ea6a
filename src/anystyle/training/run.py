"""One run of a training: build its parts, resume from its checkpoint, train, and export its weights."""

import hashlib
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from torch import nn
from torch.distributed import DistBackendError

from anystyle.contracts import Backbone, Loss, Renderer, SceneSource, StyleEncoder, StyleSource
from anystyle.contracts.scene import required
from anystyle.contracts.training import Training
from anystyle.errors import UserError, one_line
from anystyle.io.atomic import write_json
from anystyle.io.checkpoint import Header, has_header, load_part, read_header, save_part, sha256
from anystyle.io.documents import Number, as_number, kept_json
from anystyle.io.record import commit
from anystyle.io.run_folder import RECORD
from anystyle.paths import expanded
from anystyle.pipeline.load import assemble, branch_header, make_scenes, require_weights, weights_file
from anystyle.registry.build import build, build_all
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose, idle, override
from anystyle.registry.jobs import command_line
from anystyle.registry.schema import runtime_arguments
from anystyle.training.callbacks import MovingAverage, RunCheckpoint, logged
from anystyle.training.data import StepData
from anystyle.training.resume import bound, exclusive, is_rank_zero, resumable
from anystyle.training.safeguards import FiniteLoss
from anystyle.training.scene_cache import with_cache
from anystyle.training.trainer import check_options, make_trainer
from anystyle.training.watching import Best, EarlyStop
from anystyle.types.seeds import seeded

METRICS = "metrics.json"
BEST = "best"
"""The folder of the weights of the best validation."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a run.

    Args:
        steps: Optimizer steps in all.
        finished: Whether it came to its end, rather than being stopped.
        metrics: The last values logged.
        weights: The files of exported weights.
        rank_zero: Whether this process is the one that writes and prints.
        stopped_by: The signal that ended it, if one did.
    """

    steps: int
    finished: bool
    metrics: Mapping[str, float]
    weights: tuple[Path, ...]
    rank_zero: bool = True
    stopped_by: str | None = None


def train(
    overrides: Sequence[str] | DictConfig, out: str | Path, on_begin: Callable[[int], None] = lambda step: None
) -> Outcome:
    """Run a training, or resume it, as ``anystyle train`` does.

    Example::

        outcome = anystyle.train(["experiment=paper_head", "scenes.root=DL3DV-10K", "styles.root=wikiart"], "runs/mine")
        outcome.weights, outcome.metrics["val/loss"]

    Args:
        overrides: In Hydra's grammar, such as ``trainer.max_steps=100``; or what ``conf/train.yaml`` composes of them.
        out: Folder of checkpoints, logs and weights; a run is resumed from the checkpoint there.
        on_begin: Called with the step to begin at (0 for a new run), once all is checked and built.
    """
    out, config = Path(out), overrides
    if not isinstance(config, DictConfig):
        named = {"name": Path(out).absolute().name, "out": str(out)}
        config = compose("train", [*(override(key, value) for key, value in named.items()), *config])
    check_options(config)
    # Before the lock, which would change a folder that may be read-only.
    if not config.fast_dev_run and (outcome := _finished(config, out)) is not None:
        return outcome
    with exclusive(out) as check, _settings_of_torch_kept(), seeded(config.seed):
        if not config.fast_dev_run:
            return _finished(config, out) or _train(config, out, on_begin, check)
        with _trial(config, out) as (short, folder):
            return replace(_train(short, folder, lambda step: None, check), weights=())


@contextmanager
def _settings_of_torch_kept() -> Iterator[None]:
    """Lightning makes algorithms deterministic for the whole process, which may go on with other work."""
    enabled = torch.are_deterministic_algorithms_enabled()
    warn_only = torch.is_deterministic_algorithms_warn_only_enabled()
    benchmark = torch.backends.cudnn.benchmark
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(enabled, warn_only=warn_only)
        torch.backends.cudnn.benchmark = benchmark


def _train(config: DictConfig, out: Path, on_begin: Callable[[int], None], check: Callable[[], None]) -> Outcome:
    # Now: the checkout may change while the run goes on with the code it was started with.
    code = {"command": command_line("train"), "commit": commit(), "torch": torch.__version__}
    last = out / "last.ckpt"
    resumed = resumable(config, last)
    # Trainer and data come first: a mistake in them shows before networks are loaded, which may take minutes.
    average = MovingAverage(float(config.average)) if config.average else None
    checkpoint = RunCheckpoint(
        last,
        every_steps=config.checkpoint.every_steps,
        every_minutes=float(config.checkpoint.every_minutes),
        check=check,
        watched=bool(config.checkpoint.best or config.get("callbacks")),
    )
    best = []
    if name := config.checkpoint.best:
        best = [
            Best(name, lambda step, value: written(out / BEST, steps=step, **{name: value}), config.checkpoint.mode)
        ]
    guard = FiniteLoss(out / "refused_batch.pt", growth=None if config.explosion is None else float(config.explosion))
    trainer = make_trainer(config, out, guard, [*best, *([average] if average else []), checkpoint])
    sources = make_sources(config)
    for kind in catalog().owner("training", str(config.training.get("_target_"))).load().needs:
        required(sources[kind], kind)
    torch.manual_seed(config.seed)
    training = make_training(config)
    data = make_data(config, training, sources)

    def written(folder: Path, **made: Any) -> tuple[Path, ...]:
        provenance = {**code, "seed": config.seed, "half": config.export.half, **made, **inputs_of(config, sources)}
        return export(config, training.exports(), folder, provenance=provenance)

    if is_rank_zero():
        write_json(out / RECORD, bound(config))
        (out / METRICS).unlink(missing_ok=True)  # of a run that had come to its end
        if resumed is None:
            shutil.rmtree(out / BEST, ignore_errors=True)
        on_begin(0 if resumed is None else resumed.step)
    with warnings.catch_warnings():
        # Lightning advises on choices that are made on purpose here.
        warnings.filterwarnings("ignore", module=r"lightning\..*")
        warnings.filterwarnings("ignore", message=".*LeafSpec.*")
        warnings.filterwarnings("ignore", message="This DataLoader will create .* worker processes")
        path = None if resumed is None else resumed.path
        try:
            trainer.fit(training, datamodule=data, ckpt_path=path, weights_only=resumed is not None or None)
        except DistBackendError as error:
            raise UserError("another process of this training has ended; its own message says why") from error
        except Exception as error:  # where a value is not finite, any operation may raise before the guard's own line
            if guard.refusal not in (None, error):
                raise guard.refusal from error
            strange = isinstance(error, (RuntimeError, KeyError, TypeError, AttributeError))
            if resumed is None or checkpoint.started or not strange:
                raise
            raise UserError(f"{resumed.path} does not match this model ({one_line(error)[:300]})") from error
    metrics = checkpoint.metrics | logged(trainer)
    steps, rank_zero = trainer.global_step, trainer.is_global_zero
    stops = (each for each in trainer.early_stopping_callbacks if isinstance(each, EarlyStop))
    if steps < trainer.max_steps and not any(each.ended for each in stops):
        return Outcome(steps, False, metrics, (), rank_zero, checkpoint.stopped_by)
    if average:
        average.swap(training)
    weights: tuple[Path, ...] = ()
    if rank_zero:
        check()
        weights = written(out, steps=steps)
        write_json(out / METRICS, dict(sorted(metrics.items())))
    return Outcome(steps, True, metrics, weights, rank_zero, checkpoint.stopped_by)


def _finished(config: DictConfig, out: Path) -> Outcome | None:
    """The outcome of a run that has ended and whose results are all there; ``None`` for any other."""
    stored: dict[str, Number] | None = kept_json(out / METRICS, dict[str, Number])
    weights = tuple(sorted(filter(has_header, out.glob("*.safetensors"))))
    if stored is None or not weights or config.resume == "changed":
        return None
    if (resumed := resumable(config, out / "last.ckpt")) is None:
        return None
    if (name := config.checkpoint.best) and not (out / BEST).is_dir():
        raise UserError(f"checkpoint.best={name}: {out} has ended without best weights; resume=never starts it again")
    if read_header(weights[0]).provenance.get("half", config.export.half) != config.export.half:
        return None  # the same weights are written once more
    metrics = {name: as_number(value) for name, value in stored.items()}
    return Outcome(resumed.step, True, metrics, weights, is_rank_zero())


@contextmanager
def _trial(config: DictConfig, out: Path) -> Iterator[tuple[DictConfig, Path]]:
    """The configuration of two steps with everything on, and a folder for them that is deleted afterwards."""
    short, folder = config.copy(), out / ".trial"
    options = {
        "fast_dev_run": False, "resume": "never", "validation_steps": min(1, config.validation_steps),
        "cache": None, "checkpoint.every_steps": 1, "trainer.max_steps": 2, "trainer.val_check_interval": 1,
        "trainer.log_every_n_steps": 1, "training.preview_every": 1,
        "training.examples": min(16, config.training.get("examples") or 16),
    }  # fmt: skip
    for key, value in options.items():
        if not key.startswith("training.") or key.removeprefix("training.") in config.training:
            OmegaConf.update(short, key, value)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield short, folder
    finally:
        if is_rank_zero():
            shutil.rmtree(folder, ignore_errors=True)


def make_training(config: DictConfig) -> Training:
    """Build the training and the parts that its constructor names."""
    arguments = runtime_arguments(catalog().owner("training", str(config.training.get("_target_"))))
    parts: dict[str, Any] = {"stylizer": assemble(config, learns=True)[0]} if "stylizer" in arguments else {}
    if "backbone" in arguments:
        require_weights(config, learns=True)
    for part, contract in (("backbone", Backbone), ("style_encoder", StyleEncoder), ("renderer", Renderer)):
        if part in arguments:
            parts[part] = build(contract, config[part])
            if (weights := config.weights.get(part)) is not None:
                load_part(weights_file(weights), parts[part], part)
    if "losses" in arguments:
        encoder = parts["stylizer"].style_encoder if "stylizer" in parts else None
        parts["losses"] = build_all(Loss, objective(config), style_encoder=encoder)
    return build(Training, config.training, **parts)


def objective(config: DictConfig) -> dict[str, Any]:
    """The terms of the objective, by name: those chosen, without those that ``without`` names.

    Options of terms that are not chosen, such as a recipe's, are left aside.
    """
    for name in [config.without] if isinstance(config.without, str) else config.without:
        catalog().find("loss", name)
    return {name: node for name, node in (config.loss or {}).items() if name not in idle(config)}


def make_sources(config: DictConfig) -> dict[str, Any]:
    """The scenes and styles of training and of validation, by their keys; ``None`` where none is configured."""

    def source(kind: str, key: str) -> Any:
        # Where a choice was taken back, an experiment's options for it may be left.
        if config.get(key) is None or config[key].get("_target_") is None:
            return None
        if kind == "styles":
            return build(StyleSource, config[key])
        built, cache = make_scenes(config, key), config.get("cache")
        return built if cache is None else with_cache(built, expanded(cache) / key)

    return {name: source(kind, name) for kind in ("scenes", "styles") for name in (kind, f"validation_{kind}")}


def inputs_of(config: DictConfig, sources: Mapping[str, Any]) -> dict[str, Any]:
    """What a training has read: the hash of each file of weights; of each source its length, of scenes their names."""
    weights = {part: sha256(weights_file(name)) for part, name in config.weights.items() if name is not None}
    data: dict[str, Any] = {}
    for name, source in sources.items():
        if source is not None:
            data[name] = {"count": len(source)}
        if isinstance(source, SceneSource):
            names = "".join(f"{source.name(scene)}\n" for scene in range(len(source)))
            data[name]["sha256 of names"] = hashlib.sha256(names.encode()).hexdigest()
    return {"weights": weights, "data": data}


def make_data(config: DictConfig, training: Training, sources: Mapping[str, Any] | None = None) -> StepData:
    """The data module of training and validation batches; by default of the sources of the configuration."""
    sources = sources or make_sources(config)
    scenes, styles = sources["validation_scenes"], sources["validation_styles"]
    validation = None
    if (scenes is not None or styles is not None) and config.validation_steps:
        # First, because a training keeps the seed of its last call.
        validation = training.batches(scenes, styles or sources["styles"], seed=config.seed + 1)
    source = training.batches(sources["scenes"], sources["styles"], seed=config.seed)
    return StepData(source, validation, validation_steps=config.validation_steps, workers=config.workers)


def export(
    config: DictConfig, exports: Mapping[str, nn.Module], out: Path, *, provenance: Mapping[str, Any]
) -> tuple[Path, ...]:
    """Write the exports of a training as weights files, with their provenance."""
    paths = []
    for part, module in exports.items():
        if part == "branch":
            header = branch_header(config, module, provenance)
        else:
            node = OmegaConf.to_container(config[part], resolve=True, enum_to_str=True) if part in config else {}
            header = Header(part=part, config={part: node}, provenance=dict(provenance))
        paths.append(out / f"{part}.safetensors")
        try:
            save_part(paths[-1], module, header, half=config.export.half)
        except OSError as error:
            raise UserError(f"{one_line(error)}; the same command writes it once there is room") from error
    return tuple(paths)
