"""The first step: from a configuration to a model with its weights."""

import logging
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn

from anystyle.branch import StyleBranch, sites_of
from anystyle.contracts import (
    Backbone,
    Injector,
    Method,
    Placement,
    Published,
    Reconstruction,
    Renderer,
    SceneSource,
    StyleEncoder,
    StylePredictor,
)
from anystyle.errors import UserError, did_you_mean, one_line
from anystyle.io.checkpoint import Header, has_header, load_part, read_header, sha256
from anystyle.io.limits import require
from anystyle.paths import expanded
from anystyle.pipeline.compiling import compile_blocks
from anystyle.pipeline.options import BranchOptions
from anystyle.pipeline.request import Request
from anystyle.registry.build import build, build_all, choice
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose
from anystyle.registry.schema import runtime_arguments
from anystyle.stylizer import Stylizer
from anystyle.types import Site, matching_sites
from anystyle.vision import weights

_log = logging.getLogger(__name__)

PARTS = ("backbone", "style_encoder", "branch")
CPU = torch.device("cpu")
PRECISIONS = ("auto", "fp32", "bf16", "reference")
_SMALLER = "choose a smaller one with model=NAME"


def weights_file(name: object) -> Path:
    """The file of a name that ``anystyle weights`` lists, or of a path."""
    if not isinstance(name, str):
        raise UserError(f"weights are named by a text, not by {name!r}")
    known = weights.files()
    path = weights.find(name) if name in known else expanded(name)
    if not path.is_file():
        raise weights.MissingWeights(
            f"there is no weights file {path}, and no weights of that name.{did_you_mean(name, known)} "
            "`anystyle weights list` names them"
        )
    return path


def make_branch(config: DictConfig, backbone: Backbone, encoder: StyleEncoder) -> StylePredictor:
    """A style branch at initialisation: copies of the backbone's parts, and injectors that are identities."""
    branch = branch_options(config)
    if branch.published:
        if (own := backbone.make_branch()) is None:
            raise UserError(f"branch.published=true: a {type(backbone).__name__} was published without a style branch")
        return own
    sites = build(Placement, config.placement).select(sites_of(backbone, branch.sh_degree))
    chosen: dict[Site, Any] = dict.fromkeys(sites, config.injector)
    for pattern, other in branch.injectors.items():
        chosen |= dict.fromkeys(matching_sites(sites, [pattern]), choice(Injector, other))

    def make_injector(site: Site) -> Injector:
        injector = catalog().owner("injector", chosen[site]["_target_"]).load()
        style_dim = encoder.token_dim if issubclass(injector, Injector) and injector.reads_tokens else encoder.dim
        if style_dim is None:
            raise UserError(f"{injector.__name__} reads tokens of style images, and this style encoder gives vectors")
        return build(Injector, chosen[site], dim=site.dim, style_dim=style_dim, site=site)

    given = {name: value for name, value in vars(branch).items() if name not in ("injectors", "published")}
    return StyleBranch(backbone, sites=sites, make_injector=make_injector, **given)


def branch_options(config: DictConfig) -> BranchOptions:
    """The checked options of the style branch; a saved configuration holds them without their types."""
    given: Any = OmegaConf.to_container(config.branch, resolve=True)
    return BranchOptions(**given)


def published_by(config: DictConfig) -> Published:
    """How checkpoints of the configured backbone load that others published."""
    plugin = catalog().owner("backbone", config.backbone._target_)
    backbone = plugin.load()
    published = backbone.checkpoints() if issubclass(backbone, Backbone) else None
    if published is None:
        raise UserError(
            f"no published checkpoints of backbone={plugin.name} are known; give a file that anystyle wrote, or null"
        )
    return published


def require_weights(config: DictConfig, *, learns: bool = False) -> None:
    """Refuse a backbone whose weights, with gradients and two moments if it ``learns``, memory does not hold."""
    if (backbone := _outline(config)) is not None:
        needed = sum(tensor.nbytes for tensor in backbone.state_dict().values()) * (4 if learns else 1)
        require(needed, f"the weights of the backbone{', with what learning adds' if learns else ''}", _SMALLER)


def _outline(config: DictConfig) -> Backbone | None:
    """The configured backbone without memory for weights; ``None`` if its constructor reads values of tensors."""
    try:
        with torch.random.fork_rng([]), _on_meta(True):
            return build(Backbone, config.backbone)
    except RuntimeError:
        return None


def make_scenes(config: DictConfig, key: str = "scenes") -> SceneSource:
    """The configured scenes; what their constructor names of the backbone is the configured one's."""
    named = runtime_arguments(catalog().owner("scenes", str(config[key].get("_target_"))))
    if not named or config.get("backbone") is None:
        return build(SceneSource, config[key])
    backbone = _outline(config) or build(Backbone, config.backbone)
    patch = backbone.patch_size
    return build(SceneSource, config[key], resolution=backbone.resolution // patch * patch, patch_size=patch)


def assemble(config: DictConfig, *, learns: bool = False) -> tuple[Stylizer, dict[str, dict[str, Any]]]:
    """Build a stylizer and load the files that ``config.weights`` names, each ours or under its publishers' names.

    Returns:
        The stylizer, and what was loaded: file name, SHA-256, provenance; by part, and where one has several networks
        the others by ``part/network``. A warning tells of an untrained branch unless it ``learns``.
    """
    branch_options(config)  # refuses what is wrong before anything is loaded
    files = {part: weights_file(name) for part, name in config.weights.items() if name is not None}
    if "backbone" not in files:
        require_weights(config)
    for file in set(files.values()):
        require(file.stat().st_size, f"the weights in {file}", _SMALLER)
    digests = {file: sha256(file) for file in set(files.values())}
    ours = {part: file for part, file in files.items() if has_header(file)}
    # A file that several parts come from is read once.
    states = {file: weights.read(file) for file in {files[part] for part in files if part not in ours}}
    if "branch" in ours:
        for part, digest in read_header(ours["branch"]).base.items():
            given = digests[files[part]] if part in files else "not given"
            if given != digest:
                raise UserError(
                    f"{ours['branch']} was trained on a {part} with SHA-256 {digest[:12]}…, and weights.{part} is "
                    f"{given[:12]}; name the file it was trained on"
                )
    published = {part: states[file] for part, file in files.items() if part not in ours}
    stylizer, headers = build_and_load(config, ours, published)
    for parameter in stylizer.branch.parameters() if learns else ():
        # Parts that come from one published file may share its tensors, and only the branch's change.
        parameter.data = parameter.data.clone()
    loaded: dict[str, dict[str, Any]] = {}
    for part, file in files.items():
        facts = dict(headers[part].provenance) if part in headers else {}
        loaded[part] = {"file": file.name, "sha256": digests[file], "provenance": facts}
    for part in PARTS:
        for index, source in enumerate(() if part in files else getattr(stylizer, part).sources):
            name = part if index == 0 else f"{part}/{source.network}"
            loaded[name] = {"file": source.file, "sha256": source.sha256, "provenance": {}}
    untrained = "%s is untrained and %s; train one, or give its file as weights.%s"
    if "backbone" not in loaded:
        effect = "its scenes mean nothing, for no weights of it are named"
        _log.warning(untrained, "the backbone", effect, "backbone")
    if "branch" not in loaded and not learns:
        effect = "its colours mean nothing" if branch_options(config).published else "changes nothing"
        effect += ", for no weights of one on this backbone are named"
        _log.warning(untrained, "the style branch", effect, "branch")
    return stylizer, loaded


def assemble_frozen(config: DictConfig, device: torch.device = CPU) -> tuple[Stylizer, dict[str, dict[str, Any]]]:
    """As :func:`assemble`, for inference on a device, by default the CPU: in ``eval`` mode, without gradients."""
    if config.precision == "auto":
        config = config.copy()
        config.precision = "fp32" if device.type == "cpu" else "reference"
    stylizer, loaded = assemble(config)
    stylizer = stylizer.requires_grad_(False).eval().to(device)
    if config.get("compile"):
        compile_blocks(stylizer)
    return stylizer, loaded


def make_method(config: DictConfig, style_encoder: StyleEncoder) -> Method:
    """The configured method with its losses; nothing of it learns."""
    if "losses" not in runtime_arguments(catalog().owner("method", str(config.method._target_))):
        return build(Method, config.method)
    from anystyle.contracts import Loss  # which brings torchmetrics

    losses = build_all(Loss, config.get("loss"), style_encoder=style_encoder)
    for loss in losses.values():
        loss.requires_grad_(False)
    return build(Method, config.method, losses=losses)


@dataclass(frozen=True)
class LoadedModel:
    """What a stylization needs of a model.

    Args:
        stylizer: With its weights, in ``eval`` mode, on the device to compute on.
        method: How a scene takes a style.
        reconstruction: What makes a scene of views; ``None`` where that depends on whether their cameras are found.
        poses: The default source of cameras.
        weights: What was loaded; see :func:`assemble`.
    """

    stylizer: Stylizer
    method: Method
    reconstruction: Reconstruction | None
    poses: str
    weights: dict[str, dict[str, Any]]

    @property
    def networks(self) -> dict[str, dict[str, Any]]:
        """What was loaded, the networks of the method with it."""
        own = [asdict(source) for source in self.method.sources]
        return self.weights | {entry["network"]: entry for entry in own if entry["file"]}


def load_model(
    request: Request,
    *,
    stylizer: Stylizer | None = None,
    reconstruction: Reconstruction | None = None,
    method: Method | None = None,
) -> LoadedModel:
    """Load the model of a request with its method and reconstruction, but for parts that are in memory already."""
    config, loaded, poses = request.config, {}, "predicted"
    if stylizer is None:
        stylizer, loaded = assemble_frozen(config, default_device())
        poses = "predicted" if stylizer.backbone.trusted_cameras else "auto"
    poses = "known" if stylizer.backbone.needs_cameras else poses
    method = method or make_method(config, stylizer.style_encoder)
    if reconstruction is None and config.get("reconstruction") is not None:
        reconstruction = build(Reconstruction, config.reconstruction)
    return LoadedModel(stylizer, method, reconstruction, poses, loaded)


def load(model: str | None = None, overrides: Sequence[str] = ()) -> Stylizer:
    """Build a stylizer with its weights, ready for use: in ``eval`` mode, without gradients.

    Args:
        model: A preset of the group ``model``; ``None`` for the default, which goes with any backbone.
        overrides: In Hydra's grammar, as ``anystyle stylize`` takes them, such as ``renderer=gsplat``.

    Raises:
        UserError: The preset or an override is unknown, or weights do not fit.
        FileNotFoundError: A file of weights is missing.
    """
    return assemble_frozen(compose("stylize", [*([] if model is None else [f"model={model}"]), *overrides]))[0]


def default_device() -> torch.device:
    """A CUDA device if there is one that computes, else the CPU; a warning says why one does not."""
    if not torch.cuda.is_available():
        return CPU
    try:
        torch.ones(2, device="cuda").sum().item()
    except (RuntimeError, AssertionError) as error:  # too old for this PyTorch, or full with what others compute
        _log.warning("the graphics card is not used, and the CPU computes (%s)", one_line(error))
        return CPU
    return torch.device("cuda")


def build_and_load(
    config: DictConfig,
    ours: Mapping[str, Path],
    published: Mapping[str, Mapping[str, Tensor]],
    style_encoder: StyleEncoder | None = None,
) -> tuple[Stylizer, dict[str, Header]]:
    """Build the parts and load each from our file or from a published state dict, which is taken without a copy.

    Returns:
        The stylizer, and the headers of our files.
    """
    headers: dict[str, Header] = {}

    def fill(part: str, module: nn.Module, state_of: str | None = None) -> None:
        if (state_of or part) in published:
            published_by(config).load(part, module, published[state_of or part])
        elif state_of is None and part in ours:
            headers[part] = load_part(ours[part], module, part)

    if (encoder := style_encoder) is None:
        with _on_meta("style_encoder" in published):
            encoder = build(StyleEncoder, config.style_encoder)
        if "style_encoder" in published:
            encoder.load_published(published["style_encoder"])
        else:
            fill("style_encoder", encoder)
        fill("style_encoder", encoder, state_of="branch")
    whole = "backbone" in published and published_by(config).parts(published["backbone"])["backbone"]
    with _on_meta(whole):
        backbone = build(Backbone, config.backbone)
        branch = make_branch(config, backbone, encoder) if whole and "branch" in published else None
    if whole:
        # While nothing is in memory: tensors are cast to these types as they come from their file.
        for module in modules_in_bf16(config.precision, backbone, branch):
            module.to(torch.bfloat16)
    fill("backbone", backbone)
    branch = branch or make_branch(config, backbone, encoder)
    fill("branch", branch)
    renderer = build(Renderer, config.renderer)
    stylizer = Stylizer(backbone=backbone, style_encoder=encoder, branch=branch, renderer=renderer)
    for module in modules_in_bf16(config.precision, backbone, branch):
        module.to(torch.bfloat16)
    stylizer.precision = "fp32" if config.precision == "auto" else config.precision
    return stylizer, headers


def _on_meta(enabled: bool) -> AbstractContextManager[object]:
    """Build modules on the meta device where it is enabled: without memory, and without initial values."""
    return torch.device("meta") if enabled else nullcontext()


def branch_header(config: DictConfig, branch: nn.Module, provenance: Mapping[str, Any]) -> Header:
    """The header of a style branch trained under ``config``; copies that did not learn are left out of its file."""
    files = {part: weights_file(name) for part, name in config.weights.items() if name is not None and part != "branch"}
    if not any(name in ("aggregator", "gaussian_head") for name, _ in branch.named_children()):
        # It holds nothing of the backbone, and fits any.
        files.pop("backbone", None)
    nodes = ("backbone", "style_encoder", "placement", "injector", "branch")
    return Header(
        part="branch",
        config={name: OmegaConf.to_container(config[name], resolve=True, enum_to_str=True) for name in nodes},
        base={part: sha256(file) for part, file in files.items()},
        provenance=dict(provenance),
        # Without a file of the backbone it is unknown what was copied.
        omitted=tuple(
            name
            for name, part in branch.named_children()
            if "backbone" in files and {each.requires_grad for each in part.parameters()} == {False}
        ),
    )


def modules_in_bf16(precision: str, backbone: Backbone, branch: StylePredictor | None = None) -> list[nn.Module]:
    """The modules whose weights a precision stores in bf16; geometry is always computed in fp32.

    ``bf16``: the transformers and Gaussian heads, half the memory. ``reference``: as the published code runs on a GPU,
    the frozen transformers, and the rest under autocast, with TF32 in what is left. ``auto``, where nothing has chosen
    for a device, as in a training: none.
    """
    if precision not in PRECISIONS:
        raise UserError(f"precision is {precision!r}; choose from {', '.join(PRECISIONS)}")
    parts: list[nn.Module] = [] if precision in ("auto", "fp32") else [backbone.embedder, backbone.aggregator]
    if precision == "bf16":
        parts += [backbone.gaussian_head, *([branch] if branch else [])]
    return parts
