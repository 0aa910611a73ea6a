"""One evaluation: compose it, build what its protocol names, judge, and write the result."""

import json
import logging
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from omegaconf import DictConfig, OmegaConf

from anystyle.contracts import Correspondence, Metric, StyleEncoder, StyleSource
from anystyle.contracts.protocol import Evaluation, Protocol
from anystyle.errors import MissingExtra, UserError
from anystyle.evaluation import plots, record
from anystyle.evaluation.provenance import foundations
from anystyle.io.atomic import LOCK, folder_lock, write_json
from anystyle.io.record import commit, machine, versions
from anystyle.io.run_folder import RECORD, refuse_changes
from anystyle.paths import expanded
from anystyle.pipeline.trained import configured, trained_run
from anystyle.ranges import checked_seed
from anystyle.registry.build import build, build_all, plugin_of
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose
from anystyle.registry.jobs import command_line
from anystyle.registry.schema import node, plain, runtime_arguments
from anystyle.types import OnProgress, no_progress
from anystyle.types.seeds import seeded

RUN_OR_IMAGES = "--run judges a model, and --stylized judges images; give one of them"
STYLIZER = ("backbone", "style_encoder", "placement", "injector", "renderer", "branch", "seed")
"""Parts of a configuration on which the images of a model depend."""
log = logging.getLogger(__name__)
Place = str | Path | None
"""A folder that may be given."""


@dataclass(frozen=True)
class Images:
    """Any method's images in folders, as :func:`anystyle.evaluation.pairing.pair` reads them."""

    content: Path
    style: Path
    stylized: Path
    depth: Path | None = None
    layout: str | None = None

    WORDS: ClassVar = ("subject=images", "protocol=folders")
    """The overrides with which a configuration is composed that :meth:`configured` completes."""

    @classmethod
    def of(cls, content: Place, style: Place, stylized: Place, depth: Place, layout: str | None) -> "Images | None":
        """The images that are given; ``None`` where none are, and a UserError where a folder is missing."""
        folders = {"content": content, "style": style, "stylized": stylized}
        missing = [f"--{name}" for name, folder in folders.items() if folder is None]
        if content is None or style is None or stylized is None:
            if len(missing) == len(folders) and depth is None and layout is None:
                return None
            said = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
            raise UserError(f"{said}; folders of images are judged with --content DIR --style DIR --stylized DIR")
        known = None if depth is None else expanded(depth)
        return cls(expanded(content), expanded(style), expanded(stylized), known, layout)

    def configured(self, config: DictConfig) -> DictConfig:
        """A configuration with these images."""
        merged = config.copy()
        merged.protocol.update({name: value and plain(str(value)) for name, value in asdict(self).items()})
        return merged

    @property
    def flags(self) -> list[str]:
        """The flags of the command that give them."""
        return [word for name, value in asdict(self).items() if value is not None for word in (f"--{name}", str(value))]


def evaluate(
    overrides: Sequence[str] = (),
    *,
    content: Place = None,
    style: Place = None,
    stylized: Place = None,
    depth: Place = None,
    layout: str | None = None,
    trained: Place = None,
    out: Place = None,
    on_progress: OnProgress = no_progress,
) -> Evaluation:
    """Judge a model on a protocol, or any method's images in folders, as ``anystyle evaluate`` does.

    Example::

        anystyle.evaluate(["protocol=table2", "root=evaluation_and_splits"], out="table2").scores["art_fid"]
        anystyle.evaluate(["metric=[psnr]"], content="photos", style="styles", stylized="results", out="theirs")

    Args:
        overrides: In Hydra's grammar, such as ``metric=[psnr,lpips]``.
        content: A folder of photographs ``SCENE/FRAME.png``; with it go ``style`` and ``stylized``.
        style: A folder of style images ``STYLE.png``.
        stylized: A folder of results.
        depth: A folder of depth maps ``SCENE/FRAME.npy``, with ``SCENE/cameras.npz`` where cameras are known.
        layout: How results are named, such as ``{scene}_{style}/*/{frame}``; by default ``{scene}/{style}/{frame}``,
            ``{scene}/{style}_{frame}`` or ``{style}/{frame}``.
        trained: The folder of a training, whose model is judged.
        out: A folder for tables, plots and images; an evaluation in it is resumed. By default ``evaluation``, in
            ``trained`` if that is given.
        on_progress: Called for every step that takes a second or more.
    """
    images = Images.of(content, style, stylized, depth, layout)
    if images is None:
        config = compose("evaluate", overrides)
    else:
        config = images.configured(compose("evaluate", [*Images.WORDS, *overrides]))
    if trained is None:
        return run(config, Path(out or "evaluation"), on_progress=on_progress)
    if images is not None:
        raise UserError(RUN_OR_IMAGES)
    folder = trained_run(Path(trained))
    return run(configured(config, folder), Path(out or folder / "evaluation"), on_progress=on_progress)


def run(
    config: DictConfig, out: Path, *, flags: Sequence[str] = (), on_progress: OnProgress = no_progress
) -> Evaluation:
    """Run the protocol of a composed configuration, and write its result; an evaluation in ``out`` is resumed.

    The ``flags`` are those of the command that are not overrides, for the record.
    """
    start = time.perf_counter()
    with seeded(checked_seed(config.seed)):
        if config.get("missing") is not None:
            config = config.copy()
            config.protocol.missing = config.missing
        plugin, options = plugin_of(Protocol, config.protocol)
        named = runtime_arguments(plugin)
        sources = make_sources(config, named)
        inputs = plugin.load().check(**options, **sources)
        parts, weights = make_parts(config, named)
        protocol = build(Protocol, config.protocol, **parts, **sources, inputs=inputs)
        judges = {name: dict(metric.weights) for name, metric in parts.get("metrics", {}).items()}
        with bind(config, weights, out, named):
            _refuse_loss(out, config)
            evaluation = protocol.run(out, on_progress)
            provenance = {
                "protocol": plugin.name,
                "variant": str(config.variant),
                "weights": {**weights, **{f"metric {name}": files for name, files in judges.items() if files}},
                "seconds": round(time.perf_counter() - start, 3),
                "machine": machine(),
                "command": command_line("evaluate", *flags, "--out", str(out)),
                "commit": commit(),
                "seed": config.seed,
                "config": OmegaConf.to_container(config, resolve=True, enum_to_str=True),
                "versions": versions(),
            }
            provenance |= foundations(provenance["config"])
            written = record.write(evaluation, out, provenance)
    plots.examples(evaluation, out / "examples.png")
    try:
        plots.spread(evaluation, out / "spread.png", caption=f"{plugin.name}, {config.variant}; n = {evaluation.size}")
    except MissingExtra as error:
        log.warning("no plot: %s", error)
    return written


def _refuse_loss(out: Path, config: DictConfig) -> None:
    """Refuse to replace scores of another variant, or of metrics that are not chosen now."""
    if (earlier := record.read(out)) is None:
        return
    before, remedy = earlier.provenance, "choose another --out, or delete that folder"
    if before.get("variant") != str(config.variant):
        raise UserError(f"{out} holds scores of variant={before.get('variant')}, not {config.variant}; {remedy}")
    if lost := _chosen(before.get("config", {})) - _chosen(config):
        every = ",".join(sorted(lost | _chosen(config)))
        raise UserError(f"{out} holds scores that would be lost; add their metrics, metric=[{every}]; or {remedy}")


def _chosen(config: Mapping[str, Any]) -> set[str]:
    """The metrics of a configuration: a variant sets options of others, too."""
    return {str(name) for name, one in (config.get("metric") or {}).items() if one is not None and "_target_" in one}


@contextmanager
def bind(config: DictConfig, weights: Mapping[str, Any], out: Path, parts: Collection[str]) -> Iterator[None]:
    """Lock a folder, and refuse it if its images come from another configuration of ``parts`` or other weights.

    Metrics may change: scores are computed from the images each time.
    """
    names = ["protocol", *(name for name in ("scenes", "styles") if name in parts)]
    names += STYLIZER if "stylizer" in parts else ()
    names += ("method", "loss") if "method" in parts else ()
    plain: Any = OmegaConf.to_container(config, resolve=True, enum_to_str=True)
    images = {name: plain.get(name) for name in names}
    images["protocol"].pop("missing", None)  # no image depends on it
    images["weights"] = {part: row["sha256"] for part, row in weights.items()}
    images = json.loads(json.dumps(images))
    with folder_lock(out, f"another evaluation is at work in {out}; wait for its end, or give another --out"):
        known = refuse_changes(out, images, "an evaluation", "choose another --out, or delete that folder")
        write_json(out / RECORD, images)
        try:
            yield
        except BaseException:
            if not known and {entry.name for entry in out.iterdir()} <= {RECORD, LOCK}:
                (out / RECORD).unlink()  # no result depends on it yet
            raise


def make_parts(config: DictConfig, named: Mapping[str, bool]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The networks that a protocol's constructor names, and the weights that were loaded for them."""
    parts: dict[str, Any] = {}
    weights: dict[str, Any] = {}
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    encoder: StyleEncoder | None = None
    if "stylizer" in named:
        from anystyle.pipeline.load import assemble_frozen, make_method

        stylizer, weights = assemble_frozen(config, device)
        parts["stylizer"] = stylizer
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
    if "styles" in sources and config.get("styles"):
        sources["styles"] = build(StyleSource, config.styles)
    return sources


def make_metrics(config: DictConfig, encoder: StyleEncoder | None, device: torch.device) -> dict[str, Metric]:
    """The metrics that are chosen, with what their constructors name; completes the configuration by it."""
    chosen = {name: config.metric[name] for name in config.metric if name in _chosen(config)}
    needed = {
        argument: name
        for name, one in chosen.items()
        for argument in runtime_arguments(catalog().owner("metric", str(one["_target_"])))
    }
    runtime: dict[str, Any] = {}
    if "style_encoder" in needed:
        runtime["style_encoder"] = encoder or _style_encoder(config, needed["style_encoder"]).to(device)
    if "correspondence" in needed:
        if config.get("correspondence") is None:
            default = catalog().find("correspondence", config.default_correspondence)
            OmegaConf.update(config, "correspondence", node(default), force_add=True)  # so that the record has it
        runtime["correspondence"] = build(Correspondence, config.correspondence)
    return build_all(Metric, chosen, **runtime)


def _style_encoder(config: DictConfig, metric: str) -> StyleEncoder:
    from anystyle.io.checkpoint import load_part
    from anystyle.pipeline.load import weights_file

    if config.get("style_encoder") is None:
        remedy = "add style_encoder=NAME (`anystyle plugins style_encoder` lists them), or subject=model model=NAME"
        raise UserError(f"metric={metric} needs a style encoder; {remedy}")
    encoder = build(StyleEncoder, config.style_encoder)
    if config.weights.style_encoder is not None:
        load_part(weights_file(config.weights.style_encoder), encoder, "style_encoder")
    return encoder.requires_grad_(False).eval()
