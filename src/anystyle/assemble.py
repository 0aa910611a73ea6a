"""From a configuration to a stylizer with its weights."""

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from anystyle.branch import StyleBranch
from anystyle.checkpoint import Header, load_part, read_header, sha256
from anystyle.contracts import Backbone, Injector, Placement, Renderer, StyleEncoder
from anystyle.perception import weights
from anystyle.registry.build import build
from anystyle.stylizer import Stylizer
from anystyle.types import Site


def weights_file(name: str) -> Path:
    """The file of a name that ``anystyle weights`` lists, or of a path."""
    return weights.find(name) if name in weights.FILES else Path(name).expanduser()


def make_branch(config: DictConfig, backbone: Backbone, style_dim: int) -> StyleBranch:
    """A style branch at birth: copies of the backbone's parts, and injectors that are identities."""
    placement = build(Placement, config.placement)

    def make_injector(site: Site) -> Injector:
        return build(Injector, config.injector, dim=site.dim, style_dim=style_dim)

    return StyleBranch(
        backbone,
        sites=placement.select(backbone.sites),
        make_injector=make_injector,
        styled=tuple(config.branch.styled),
        sh_degree=config.branch.sh_degree,
    )


def assemble(config: DictConfig) -> tuple[Stylizer, dict[str, dict[str, Any]]]:
    """Build a stylizer and load its weights.

    Args:
        config: Nodes ``backbone, style_encoder, placement, injector, renderer, branch`` and ``weights``, which names a
            file for each of ``backbone, style_encoder, branch``, or ``null`` for a part left as initialised.

    Returns:
        The stylizer, and for each part what was loaded: file name, SHA-256, provenance.

    Raises:
        ValueError: A file does not fit, or was trained on top of other weights than those named.
        FileNotFoundError: A file is missing.
    """
    backbone = build(Backbone, config.backbone)
    style_encoder = build(StyleEncoder, config.style_encoder)
    files = {part: weights_file(name) for part, name in config.weights.items() if name is not None}
    digests = {part: sha256(file) for part, file in files.items() if file.is_file()}
    loaded: dict[str, Header] = {}
    for part, module in (("backbone", backbone), ("style_encoder", style_encoder)):
        if part in files:
            loaded[part] = load_part(files[part], module, part)
    if "branch" in files:
        _check_base(files["branch"], digests)
    branch = make_branch(config, backbone, style_encoder.dim)
    if "branch" in files:
        loaded["branch"] = load_part(files["branch"], branch, "branch")
    stylizer = Stylizer(
        backbone=backbone, style_encoder=style_encoder, branch=branch, renderer=build(Renderer, config.renderer)
    )
    found = {
        part: {"file": files[part].name, "sha256": digests[part], "provenance": dict(header.provenance)}
        for part, header in loaded.items()
    }
    return stylizer, found


def _check_base(file: Path, digests: dict[str, str]) -> None:
    """Refuse a branch that was trained on top of other weights."""
    for part, digest in read_header(file).base.items():
        if digests.get(part) != digest:
            raise ValueError(
                f"{file} was trained on a {part} with SHA-256 {digest[:12]}…, and weights.{part} is "
                f"{digests.get(part, 'not given')[:12]}; name the file it was trained on"
            )


def branch_header(config: DictConfig, provenance: dict[str, Any]) -> Header:
    """The header of a style branch trained under ``config``."""
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
    )
