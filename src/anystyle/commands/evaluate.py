"""Judge a model on a protocol, or any method's images in folders."""

import argparse
import platform
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from anystyle.commands._compose import describe, job_folder, launch, override, run, split, with_sweep
from anystyle.commands._flags import new_parser
from anystyle.commands._options import Shared, checked
from anystyle.commands._run import words_of
from anystyle.contracts import Correspondence, Metric, SceneSource, StyleEncoder, StyleSource
from anystyle.errors import UserError
from anystyle.evaluation import plots, record
from anystyle.evaluation.contract import Evaluation, Protocol
from anystyle.evaluation.resume import bind
from anystyle.inference.assemble import assemble_frozen, default_device, make_method, weights_file
from anystyle.io.checkpoint import load_part
from anystyle.registry.build import build, build_all
from anystyle.registry.catalog import catalog
from anystyle.registry.schema import runtime_arguments

FOLDERS = ("content", "style", "stylized", "depth")


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle evaluate``; every other word is a Hydra override."""
    flags = new_parser(
        "evaluate",
        "Judge a model on a protocol (protocol=paper_image scenes=folder scenes.root=DIR styles=folder "
        "styles.root=DIR), or any method's images (--content, --style, --stylized).",
    )
    flags.add_argument("--content", metavar="DIR", help="photographs: SCENE/FRAME.png")
    flags.add_argument("--style", metavar="DIR", help="style images: STYLE.png")
    flags.add_argument("--stylized", metavar="DIR", help="results: SCENE/STYLE_FRAME.png or SCENE/STYLE/FRAME.png")
    flags.add_argument("--depth", metavar="DIR", help="depth: SCENE/FRAME.npy, and SCENE/cameras.npz if known")
    flags.add_argument("--run", metavar="DIR", dest="trained", help="judge what a training run, or multirun, made")
    flags.add_argument("--out", default=None, help="where the results go (default: evaluation, or in the run)")
    return flags


def folder_words(arguments: argparse.Namespace) -> list[str]:
    """The overrides that flags naming folders stand for.

    Raises:
        UserError: Some of the three folders are named, and not all.
    """
    named = {name: getattr(arguments, name) for name in FOLDERS if getattr(arguments, name) is not None}
    if not named:
        return []
    missing = [f"--{name}" for name in FOLDERS[:3] if name not in named]
    if missing:
        raise UserError(
            f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing; folders of images "
            "are judged with --content DIR --style DIR --stylized DIR"
        )
    if arguments.trained is not None:
        raise UserError("--run judges a model, and --stylized judges images; give one of them")
    absolute = {name: str(Path(value).expanduser()) for name, value in named.items()}
    return ["protocol=folders", *(override(f"protocol.{name}", value) for name, value in absolute.items())]


def evaluate(config: DictConfig, out: Path) -> Evaluation:
    """Run a protocol, and write what it returns.

    Args:
        config: What ``conf/evaluate.yaml`` composes.
        out: The folder for everything; an evaluation that is there goes on.

    Returns:
        What the protocol returned.

    Raises:
        ValueError: The configuration contradicts itself, or images cannot be judged.
    """
    start = time.perf_counter()
    torch.manual_seed(checked(config, Shared).seed)
    plugin = catalog().owner("protocol", str(config.protocol.get("_target_")))
    named = runtime_arguments(plugin)
    parts, weights = make_parts(config, named)
    protocol = build(Protocol, config.protocol, **parts)
    judges = {name: dict(metric.weights) for name, metric in parts.get("metrics", {}).items()}
    with bind(config, weights, out, named, judges):
        with Bar() as progress:
            evaluation = protocol.run(out, progress)
        provenance = {
            "protocol": plugin.name,
            "variant": str(config.variant),
            "weights": {**weights, **{f"metric {name}": files for name, files in judges.items() if files}},
            "seconds": round(time.perf_counter() - start, 3),
            "machine": machine(),
            "command": shlex.join(["anystyle", "evaluate", *sys.argv[1:]]),
            "seed": config.seed,
            "config": OmegaConf.to_container(config, resolve=True, enum_to_str=True),
            "versions": {name: version(name) for name in ("anystyle", "torch", "numpy")},
        }
        table = record.write(evaluation, out, provenance)
    draw(evaluation, out, f"{plugin.name}, {config.variant}; n = {evaluation.n}")
    print(table.markdown(), end="")
    print(f"\nin {out}: {', '.join(path.name for path in sorted(out.iterdir()) if path.is_file())}")
    return evaluation


def draw(evaluation: Evaluation, out: Path, caption: str) -> None:
    """Write the pictures of an evaluation, as far as what they need is installed."""
    plots.examples(evaluation, out / "examples.png")
    try:
        plots.spread(evaluation, out / "spread.png", caption=caption)
    except ImportError as error:
        print(f"no plot: {error}", file=sys.stderr)


def make_parts(config: DictConfig, named: Mapping[str, bool]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The parts that a protocol's constructor names, and the weights that were loaded for them."""
    parts: dict[str, Any] = {}
    weights: dict[str, Any] = {}
    device = default_device()
    encoder: StyleEncoder | None = None
    if "stylizer" in named:
        stylizer, weights = assemble_frozen(config)
        parts["stylizer"] = stylizer.to(device)
        encoder = stylizer.style_encoder
        if "method" in named:
            parts["method"] = make_method(config, encoder)
    if "metrics" in named:
        parts["metrics"] = {name: metric.to(device) for name, metric in make_metrics(config, encoder, device).items()}
    for name, base in (("scenes", SceneSource), ("styles", StyleSource)):
        if name in named:
            parts[name] = None if config.get(name) is None else build(base, config[name])
    return parts, weights


def make_metrics(config: DictConfig, encoder: StyleEncoder | None, device: torch.device) -> dict[str, Metric]:
    """The metrics that are chosen, with what their constructors name."""
    # A variant sets options of metrics that may not be among those chosen.
    chosen = {str(name): node for name, node in config.metric.items() if node is not None and "_target_" in node}
    needed = {
        name for node in chosen.values() for name in runtime_arguments(catalog().owner("metric", str(node["_target_"])))
    }
    runtime: dict[str, Any] = {}
    if "style_encoder" in needed:
        runtime["style_encoder"] = encoder or _style_encoder(config).to(device)
    if "correspondence" in needed and config.correspondence is not None:
        runtime["correspondence"] = build(Correspondence, config.correspondence)
    return build_all(Metric, chosen, **runtime)


def _style_encoder(config: DictConfig) -> StyleEncoder:
    encoder = build(StyleEncoder, config.style_encoder)
    if config.weights.style_encoder is not None:
        load_part(weights_file(config.weights.style_encoder), encoder, "style_encoder")
    return encoder.requires_grad_(False).eval()


def machine() -> str:
    """What the figures were computed on, in a few words."""
    gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else ""
    return f"{platform.machine()} {platform.system()}, {gpu or f'CPU with {torch.get_num_threads()} thread(s)'}"


def main(words: Sequence[str] | None = None) -> None:
    """Be the command: with ``--run``, once for each run that is found."""

    def command() -> None:
        from anystyle.evaluation.runs import trained_runs

        flags = parser()
        describe(flags)
        given = with_sweep(flags, words_of(words), "hydra.output_subdir=.hydra")
        arguments, rest = split(flags, given)
        rest = [*folder_words(arguments), *rest]
        if arguments.trained is None:
            launch("evaluate", lambda config: evaluate(config, job_folder(arguments.out or "evaluation")), rest)
            return
        runs = trained_runs(Path(arguments.trained))
        for run_ in runs:
            out = run_.folder / "evaluation" if arguments.out is None else Path(arguments.out)
            if arguments.out is not None and len(runs) > 1:
                out = out / run_.folder.name
            print(f"{run_.folder}", file=sys.stderr)
            launch("evaluate", lambda config, run_=run_, out=out: evaluate(run_.into(config), out), rest)

    run(command)


_QUIET_SECONDS = 10.0


class Bar:
    """Told of stages, shows a progress bar for each; without a terminal a line for each stage, and now and then one."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._stage = ""
        self._spoken = 0.0
        self._bars = None
        self._task = None

    def __enter__(self) -> "Bar":
        if self._terminal:
            from rich.console import Console
            from rich.progress import Progress, TimeRemainingColumn

            self._bars = Progress(
                *Progress.get_default_columns()[:-1], TimeRemainingColumn(), console=Console(stderr=True)
            )
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Say how far a stage is."""
        if self._bars is not None:
            if stage != self._stage:
                self._task = self._bars.add_task(stage, total=total)
            assert self._task is not None
            self._bars.update(self._task, completed=done, total=total)
        elif stage != self._stage or done == total or time.monotonic() - self._spoken > _QUIET_SECONDS:
            print(f"{stage} {done}/{total} …", file=sys.stderr, flush=True)
            self._spoken = time.monotonic()
        self._stage = stage


if __name__ == "__main__":
    main()
