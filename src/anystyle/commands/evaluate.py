"""Judge a model on a protocol, or any method's images in folders."""

import argparse
import platform
import sys
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf, open_dict

from anystyle.cli.arguments import new_parser, split
from anystyle.cli.launch import checked_seed, describe, job_folder, launch, override, returned, with_sweep
from anystyle.cli.run import run, words_of
from anystyle.contracts import Correspondence, Metric, StyleEncoder, StyleSource
from anystyle.contracts.protocol import Evaluation, Protocol
from anystyle.errors import UserError
from anystyle.evaluation import plots, record
from anystyle.evaluation.config_lock import bind
from anystyle.evaluation.runs import job_order
from anystyle.io.checkpoint import read_header
from anystyle.io.documents import read_json
from anystyle.paths import expanded
from anystyle.pipeline.provenance import commit
from anystyle.registry.build import build, build_all, plugin_of
from anystyle.registry.catalog import catalog
from anystyle.registry.jobs import command_line
from anystyle.registry.schema import runtime_arguments
from anystyle.registry.untrusted import check_saved
from anystyle.types import OnStep

BRANCH = "branch.safetensors"
FOLDERS = ("content", "style", "stylized", "depth")
MODEL = ("subject", "model", "backbone", "placement", "injector", "renderer", "method", "loss", "branch", "precision")
"""Groups of a model."""


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle evaluate``; every other word is a Hydra override."""
    flags = new_parser(
        "evaluate",
        "Judge a model on a protocol (protocol=paper_image scenes=folder scenes.root=DIR styles=folder "
        "styles.root=DIR), or any method's images (--content, --style, --stylized; missing=allow if some are absent).",
    )
    flags.add_argument("--content", metavar="DIR", help="photographs: SCENE/FRAME.png")
    flags.add_argument("--style", metavar="DIR", help="style images: STYLE.png")
    flags.add_argument("--stylized", metavar="DIR", help="results: SCENE/STYLE/FRAME.png or SCENE/STYLE_FRAME.png")
    flags.add_argument("--depth", metavar="DIR", help="depth: SCENE/FRAME.npy, and SCENE/cameras.npz if known")
    flags.add_argument("--run", metavar="DIR", dest="trained", help="judge what a training run, or multirun, made")
    flags.add_argument("--out", default=None, help="where the results go (default: evaluation, or in the run)")
    return flags


def folder_words(arguments: argparse.Namespace) -> list[str]:
    """The overrides that flags naming folders stand for."""
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
    absolute = {name: str(expanded(value)) for name, value in named.items()}
    return ["protocol=folders", *(override(f"protocol.{name}", value) for name, value in absolute.items())]


def subject_words(words: Sequence[str]) -> list[str]:
    """The override that leaves the model out, if the protocol takes no stylizer and no word chooses a part of one."""
    chosen = {key: value for key, _, value in (word.partition("=") for word in words)}
    name = chosen.get("protocol", "")
    if name not in catalog().names("protocol") or any(key.partition(".")[0] in MODEL for key in chosen):
        return []  # presets of protocols are the paper's, which judge a model
    return [] if "stylizer" in runtime_arguments(catalog().find("protocol", name)) else ["subject=images"]


def evaluate(config: DictConfig, out: Path, *flags: str) -> Evaluation:
    """Run the protocol of a composed configuration, and write its result; an evaluation in ``out`` is resumed.

    The ``flags`` are those of the command that are no overrides, for the record.
    """
    start = time.perf_counter()
    torch.manual_seed(checked_seed(config.seed))
    plugin, options = plugin_of(Protocol, config.protocol)
    named = runtime_arguments(plugin)
    sources = make_sources(config, named)
    plugin.load().check(**options, **sources)
    parts, weights = make_parts(config, named)
    parts |= sources
    protocol = build(Protocol, config.protocol, **parts)
    judges = {name: dict(metric.weights) for name, metric in parts.get("metrics", {}).items()}
    with bind(config, weights, out, named):
        evaluation = protocol.run(out, progress_lines())
        gpu = torch.cuda.get_device_name() if torch.cuda.is_available() else ""
        device = gpu or f"CPU with {torch.get_num_threads()} thread(s)"
        provenance = {
            "protocol": plugin.name,
            "variant": str(config.variant),
            "weights": {**weights, **{f"metric {name}": files for name, files in judges.items() if files}},
            "seconds": round(time.perf_counter() - start, 3),
            "machine": f"{platform.machine()} {platform.system()}, {device}",
            "command": command_line("evaluate", *flags, "--out", str(out)),
            "commit": commit(),
            "seed": config.seed,
            "config": OmegaConf.to_container(config, resolve=True, enum_to_str=True),
            "versions": {name: version(name) for name in ("anystyle", "torch", "numpy")},
        }
        table = record.write(evaluation, out, provenance)
    plots.examples(evaluation, out / "examples.png")
    try:
        plots.spread(evaluation, out / "spread.png", caption=f"{plugin.name}, {config.variant}; n = {evaluation.size}")
    except ImportError as error:
        print(f"no plot: {error}", file=sys.stderr)
    print(table.markdown(), end="")
    print(f"\nin {out}: {', '.join(path.name for path in sorted(out.iterdir()) if path.is_file())}")
    return evaluation


def make_parts(config: DictConfig, named: Mapping[str, bool]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The networks that a protocol's constructor names, and the weights that were loaded for them."""
    parts: dict[str, Any] = {}
    weights: dict[str, Any] = {}
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    encoder: StyleEncoder | None = None
    if "stylizer" in named:
        from anystyle.pipeline.load import assemble_frozen, make_method

        stylizer, weights = assemble_frozen(config)
        parts["stylizer"] = stylizer.to(device)
        encoder = stylizer.style_encoder
        if "method" in named:
            parts["method"] = make_method(config, encoder)
    if "metrics" in named:
        parts["metrics"] = {name: metric.to(device) for name, metric in make_metrics(config, encoder, device).items()}
    return parts, weights


def make_sources(config: DictConfig, named: Mapping[str, bool]) -> dict[str, Any]:
    """The scenes and styles that a protocol's constructor names; ``None`` for one that is not configured."""
    sources: dict[str, Any] = dict.fromkeys({"scenes", "styles"} & set(named))
    if "scenes" in sources and config.get("scenes") is not None:
        from anystyle.pipeline.load import make_scenes

        sources["scenes"] = make_scenes(config)
    if "styles" in sources and config.get("styles") is not None:
        sources["styles"] = build(StyleSource, config.styles)
    return sources


def make_metrics(config: DictConfig, encoder: StyleEncoder | None, device: torch.device) -> dict[str, Metric]:
    """The metrics that are chosen, with what their constructors name."""
    # A variant sets options of metrics that may not be among those chosen.
    chosen = {str(name): node for name, node in config.metric.items() if node is not None and "_target_" in node}
    needed = {
        argument: name
        for name, node in chosen.items()
        for argument in runtime_arguments(catalog().owner("metric", str(node["_target_"])))
    }
    runtime: dict[str, Any] = {}
    if "style_encoder" in needed:
        runtime["style_encoder"] = encoder or _style_encoder(config, needed["style_encoder"]).to(device)
    if "correspondence" in needed and config.correspondence is not None:
        runtime["correspondence"] = build(Correspondence, config.correspondence)
    return build_all(Metric, chosen, **runtime)


def _style_encoder(config: DictConfig, metric: str) -> StyleEncoder:
    from anystyle.io.checkpoint import load_part
    from anystyle.pipeline.load import weights_file

    if config.get("style_encoder") is None:
        raise UserError(
            f"metric={metric} needs a style encoder; add style_encoder=NAME (`anystyle plugins style_encoder` lists "
            "them), or a model=NAME with one"
        )
    encoder = build(StyleEncoder, config.style_encoder)
    if config.weights.style_encoder is not None:
        load_part(weights_file(config.weights.style_encoder), encoder, "style_encoder")
    return encoder.requires_grad_(False).eval()


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle evaluate``; with ``--run``, once for each run found."""

    def command() -> None:
        flags = parser()
        describe(flags)
        given = with_sweep(flags, words_of(words), "hydra.output_subdir=.hydra")
        arguments, rest = split(flags, given)
        # The protocol's option, named without it.
        rest = [f"protocol.{word}" if word.startswith("missing=") else word for word in rest]
        rest = [*folder_words(arguments), *rest]
        if arguments.trained is None:
            rest = [*subject_words(rest), *rest]

            def judged(config: DictConfig) -> Any:
                return returned(config.objective, evaluate(config, job_folder(arguments.out or "evaluation")).figures)

            launch("evaluate", judged, rest)
            return
        folders = trained_runs(Path(arguments.trained))
        for folder in folders:
            out = folder / "evaluation" if arguments.out is None else Path(arguments.out)
            if arguments.out is not None and len(folders) > 1:
                out = out / folder.name
            print(folder, file=sys.stderr)

            def of_run(config: DictConfig, folder: Path = folder, out: Path = out) -> Any:
                evaluation = evaluate(configured(config, folder), out, "--run", str(folder))
                return returned(config.objective, evaluation.figures)

            launch("evaluate", of_run, rest)

    run(command)


def trained_runs(folder: Path) -> list[Path]:
    """The folders that hold a style branch: a run itself, or the jobs of a multirun in order."""
    if not folder.is_dir():
        raise UserError(f"there is no run {folder}")
    jobs = sorted((path.parent for path in folder.glob(f"*/{BRANCH}")), key=job_order)
    folders = [folder] if (folder / BRANCH).is_file() else jobs
    if not folders:
        raise UserError(f"{folder} holds no finished training of a style branch ({BRANCH}, in it or in its jobs)")
    return folders


def configured(config: DictConfig, folder: Path) -> DictConfig:
    """A configuration with the parts, options and weights of a run."""
    what = "record of a run, which names the weights it was trained on"
    bound: dict[str, Any] = read_json(folder / "bound.json", dict[str, Any], what=what)
    saved = check_saved(read_header(folder / BRANCH).config, folder / BRANCH)
    merged = config.copy()
    with open_dict(merged):
        for part, node in saved.items():
            merged[part] = OmegaConf.create(node) if isinstance(node, dict) else node
        weights = {key.removeprefix("weights."): value for key, value in bound.items() if key.startswith("weights.")}
        merged.weights = {**weights, "branch": str(folder / BRANCH)}
    return merged


def progress_lines() -> OnStep:
    """Prints a line for each stage, and another every ten seconds."""
    printed: dict[str, float] = {}

    def write(stage: str, done: int, total: int) -> None:
        if done == total or time.monotonic() - printed.get(stage, -10) >= 10:
            print(f"{stage} {done}/{total} …", file=sys.stderr, flush=True)
            printed[stage] = time.monotonic()

    return write


if __name__ == "__main__":
    main()
