"""From a configuration to a stylizer with its weights."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn

from anystyle.branch import StyleBranch
from anystyle.checkpoint import Header, has_header, load_part, read_header, sha256
from anystyle.contracts import Backbone, Injector, Placement, Published, Renderer, StyleEncoder
from anystyle.errors import did_you_mean
from anystyle.perception import weights
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.stylizer import Stylizer, lowered
from anystyle.types import Site

PARTS = ("backbone", "style_encoder", "branch")
State = Mapping[str, Tensor]


def weights_file(name: str) -> Path:
    """The file of a name that ``anystyle weights`` lists, or of a path.

    Raises:
        FileNotFoundError: It is neither.
    """
    known = weights.files()
    path = weights.find(name) if name in known else Path(name).expanduser()
    if not path.is_file():
        raise FileNotFoundError(
            f"there is no weights file {path}, and no weights of that name.{did_you_mean(name, known)} "
            "`anystyle weights list` names them"
        )
    return path


def make_branch(
    config: DictConfig, backbone: Backbone, style_dim: int, options: Mapping[str, Mapping[str, int]] | None = None
) -> StyleBranch:
    """A style branch at birth: copies of the backbone's parts, and injectors that are identities.

    Args:
        config: Nodes ``placement, injector, branch``.
        backbone: What to copy from.
        style_dim: Dimensions of the style embedding.
        options: Options of the injector at some sites, instead of the configuration's.
    """
    placement = build(Placement, config.placement)

    def make_injector(site: Site) -> Injector:
        node = OmegaConf.to_container(config.injector, resolve=True, enum_to_str=True)
        assert isinstance(node, dict)
        own = dict((options or {}).get(site.name, {}))
        return build(
            Injector, {str(key): value for key, value in node.items()} | own, dim=site.dim, style_dim=style_dim
        )

    return StyleBranch(
        backbone,
        sites=placement.select(backbone.sites),
        make_injector=make_injector,
        styled=tuple(config.branch.styled),
        sh_degree=config.branch.sh_degree,
    )


def published_by(config: DictConfig) -> Published:
    """How checkpoints of the configured backbone load that others published.

    Raises:
        ValueError: None are known.
    """
    plugin = catalog().owner("backbone", config.backbone._target_)
    backbone = plugin.load()
    published = backbone.published if issubclass(backbone, Backbone) else None
    if published is None:
        raise ValueError(
            f"no published checkpoints of backbone={plugin.name} are known; give a file that anystyle wrote, or null"
        )
    return published


def assemble(config: DictConfig) -> tuple[Stylizer, dict[str, dict[str, Any]]]:
    """Build a stylizer and load its weights.

    Args:
        config: Nodes ``backbone, style_encoder, placement, injector, renderer, branch, precision`` and ``weights``,
            which names a file for each of ``backbone, style_encoder, branch``, or ``null`` for a part left as
            initialised. A file is one of ours, or holds weights under the names that their publishers gave them.

    Returns:
        The stylizer, and for each part what was loaded: file name, SHA-256, provenance.

    Raises:
        ValueError: A file does not fit, or was trained on top of other weights than those named.
        FileNotFoundError: A file is missing.
    """
    files = {part: weights_file(name) for part, name in config.weights.items() if name is not None}
    known = {file: sha256(file) for file in set(files.values()) if file.is_file()}
    digests = {part: known[file] for part, file in files.items() if file in known}
    ours = {part: file for part, file in files.items() if has_header(file)}
    # A file that several parts come from is read once.
    states = {file: weights.read(file) for file in {files[part] for part in files if part not in ours}}
    if "branch" in ours:
        _check_base(ours["branch"], digests)
    stylizer, headers = put_together(config, ours, {part: states[files[part]] for part in files if part not in ours})
    found = {
        part: {
            "file": file.name,
            "sha256": digests[part],
            "provenance": dict(headers[part].provenance) if part in headers else {},
        }
        for part, file in files.items()
    }
    return stylizer, found


def put_together(
    config: DictConfig,
    ours: Mapping[str, Path],
    published: Mapping[str, State],
    style_encoder: StyleEncoder | None = None,
) -> tuple[Stylizer, dict[str, Header]]:
    """Build the parts and load each; what a published state dict holds is taken as it is, with no copy on the way.

    Args:
        config: As for :func:`assemble`.
        ours: Files that anystyle wrote, by part.
        published: State dicts with their publishers' names, by part.
        style_encoder: Instead of the configured one.

    Returns:
        The stylizer, and the headers of our files.
    """
    headers: dict[str, Header] = {}
    encoder = style_encoder or _style_encoder(config, ours, published, headers)
    whole = "backbone" in published and published_by(config).complete(published["backbone"])
    with _empty(whole):
        backbone = build(Backbone, config.backbone)
    options = _injector_options(config, backbone, published, encoder)
    branch = None
    if whole and "branch" in published:
        with _empty(True):
            branch = make_branch(config, backbone, encoder.dim, options)
    if whole:
        # While nothing is in memory: tensors are brought to the types that are wanted as they come from their file.
        for module in lowered(config.precision, backbone, branch):
            module.to(torch.bfloat16)
    if "backbone" in published:
        published_by(config).load_backbone(backbone, published["backbone"])
    elif "backbone" in ours:
        headers["backbone"] = load_part(ours["backbone"], backbone, "backbone")
    branch = branch or make_branch(config, backbone, encoder.dim, options)
    if "branch" in published:
        published_by(config).load_branch(branch, published["branch"])
    elif "branch" in ours:
        headers["branch"] = load_part(ours["branch"], branch, "branch")
    renderer = build(Renderer, config.renderer)
    stylizer = Stylizer(backbone=backbone, style_encoder=encoder, branch=branch, renderer=renderer)
    return stylizer.set_precision(config.precision), headers


def _style_encoder(
    config: DictConfig, ours: Mapping[str, Path], published: Mapping[str, State], headers: dict[str, Header]
) -> StyleEncoder:
    given = published.get("style_encoder")
    with _empty(given is not None):
        encoder = build(StyleEncoder, config.style_encoder)
    if "style_encoder" in ours:
        headers["style_encoder"] = load_part(ours["style_encoder"], encoder, "style_encoder")
    if given is None and "branch" not in published:
        return encoder
    loader = encoder.published
    if loader is None:
        if given is None:
            return encoder
        raise ValueError(f"no published weights of a {type(encoder).__name__} are known; give a file of ours, or null")
    if "branch" in published:
        loader.load_text_adapter(encoder, published_by(config).text_adapter(published["branch"]))
    if given is not None:
        loader.load(encoder, given)
    return encoder


def _injector_options(
    config: DictConfig, backbone: Backbone, published: Mapping[str, State], encoder: StyleEncoder
) -> dict[str, dict[str, int]]:
    """Widths of the injectors that a published branch holds."""
    if "branch" not in published:
        return {}
    sites = build(Placement, config.placement).select(backbone.sites)
    found = published_by(config).injector_options(published["branch"], sites)
    trained = {options.pop("style_dim") for options in found.values()}
    if trained - {encoder.dim}:
        raise ValueError(
            f"the style branch was trained with embeddings of {max(trained)} numbers, and the style encoder's have "
            f"{encoder.dim}; choose the encoder it was trained with (style_encoder=long_clip)"
        )
    return found


@contextlib.contextmanager
def _empty(wanted: bool) -> Any:
    """Whether modules are built on the meta device: without memory, and without initial values."""
    with torch.device("meta") if wanted else contextlib.nullcontext():
        yield


def _check_base(file: Path, digests: dict[str, str]) -> None:
    """Refuse a branch that was trained on top of other weights."""
    for part, digest in read_header(file).base.items():
        if digests.get(part) != digest:
            raise ValueError(
                f"{file} was trained on a {part} with SHA-256 {digest[:12]}…, and weights.{part} is "
                f"{digests.get(part, 'not given')[:12]}; name the file it was trained on"
            )


def branch_header(config: DictConfig, branch: nn.Module, provenance: Mapping[str, Any]) -> Header:
    """The header of a style branch trained under ``config``; copies that did not learn are left out of its file."""
    files = {part: weights_file(name) for part, name in config.weights.items() if name is not None and part != "branch"}
    kept = OmegaConf.to_container(
        OmegaConf.masked_copy(config, ["backbone", "style_encoder", "placement", "injector", "branch"]),
        resolve=True,
        enum_to_str=True,
    )
    assert isinstance(kept, dict)
    return Header(
        part="branch",
        config={str(key): value for key, value in kept.items()},
        base={part: sha256(file) for part, file in files.items()},
        provenance=provenance,
        # Without a file of the backbone nothing says what was copied.
        omitted=tuple(name for name, part in branch.named_children() if "backbone" in files and _is_frozen(part)),
    )


def _is_frozen(part: nn.Module) -> bool:
    parameters = list(part.parameters())
    return bool(parameters) and not any(parameter.requires_grad for parameter in parameters)
