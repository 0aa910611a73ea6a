"""Recognising a file of weights by its keys and checking that it is whole, for ``weights verify`` and ``convert``."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import torch
from omegaconf import OmegaConf
from torch import Tensor

from anystyle.contracts import Backbone, StyleEncoder
from anystyle.errors import UserError
from anystyle.io.checkpoint import Header, differences, has_header, read_header, sha256
from anystyle.pipeline.load import build_and_load, make_branch
from anystyle.pipeline.weights import reference_config
from anystyle.registry.build import build
from anystyle.registry.catalog import PluginError, catalog
from anystyle.registry.untrusted import check_saved
from anystyle.vision import weights
from anystyle.vision.networks import NETWORKS
from anystyle.vision.state_dict_formats import LAYOUTS, layout_of

State = Mapping[str, Tensor]


class Recognised(NamedTuple):
    """A whole file of weights: its kind, what it holds, line by line, and its tensors without prefixes."""

    layout: str
    holds: tuple[str, ...]
    state: State


def existing(name: str) -> Path:
    """The file of a path, or of a row of the table."""
    path = weights.find(name) if name in weights.files() else Path(name).expanduser()
    if not path.is_file():
        raise UserError(f"there is no file {path}; name a file, or a row of `anystyle weights`")
    return path


def recognise(path: Path) -> Recognised:
    """Recognise a file's kind and check strictly that it is whole."""
    header = read_header(path) if has_header(path) else None
    state = weights.read(path)
    for key, tensor in state.items():
        if tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            raise UserError(f"{path} is damaged: {key} holds values that are infinite or no numbers")
    if header is not None:
        _check_ours(path, header, state)
        provenance = ", ".join(f"{key} {value}" for key, value in header.provenance.items())
        about = f"{header.part} that anystyle wrote{f' ({provenance})' if provenance else ''}"
        return Recognised("anystyle", (about,), state)
    name = layout_of(state)
    if name is not None:
        LAYOUTS[name].check(path)
        return Recognised(name, (LAYOUTS[name].about,), LAYOUTS[name].names(state))
    for backbone in catalog().names("backbone"):
        recognised = _of_backbone(backbone, state)
        if recognised is not None:
            return recognised
    names, known = ", ".join(list(state)[:5]), ", ".join(LAYOUTS)
    raise UserError(
        f"{path} is of no known kind: {len(state)} tensors, such as {names}; known are {known} and the checkpoints of "
        "backbones"
    )


def _check_ours(path: Path, header: Header, state: State) -> None:
    """Compare a file that anystyle wrote with the network that its header describes, without memory for it."""
    check_saved(header.config, path)
    config = OmegaConf.create(header.config)
    with torch.device("meta"):
        match header.part:
            case "backbone":
                module = build(Backbone, config.get("backbone", {}))
            case "style_encoder":
                module = build(StyleEncoder, config.get("style_encoder", {}))
            case "branch":
                encoder = build(StyleEncoder, config.get("style_encoder", {}))
                module = make_branch(config, build(Backbone, config.get("backbone", {})), encoder.dim)
            case part if part in NETWORKS:
                module = NETWORKS[part]()
            case part:
                if any(row.file == path.name and row.sha256 == sha256(path) for row in weights.files().values()):
                    return
                parts = ", ".join(("backbone", "style_encoder", "branch", *NETWORKS))
                raise UserError(f"{path} holds an unknown part {part[:80]!r}; known are {parts}")
    expected = {key: tensor for key, tensor in module.state_dict().items() if not header.omits(key)}
    if unlike := differences(expected, state):
        raise UserError(f"{path} does not fit the {header.part} that its header describes: {unlike}")


def _of_backbone(name: str, state: State) -> Recognised | None:
    """A published state dict of a backbone's; ``None`` if it is of another network."""
    try:
        loaded = catalog().find("backbone", name).load()
        published = loaded.published if issubclass(loaded, Backbone) else None
        if published is None:
            return None
        parts = published.parts(state)
        config = reference_config(state, [f"backbone={name}"])
    except (PluginError, UserError):
        return None
    if parts["backbone"]:
        build_and_load(config, {}, {part: state for part in ("backbone", "branch") if part in parts})
    else:
        with torch.device("meta"):
            backbone = build(Backbone, config.backbone)
        published.load("backbone", backbone, state)
    count = sum(tensor.numel() for tensor in state.values())
    types = ", ".join(sorted({str(tensor.dtype).removeprefix("torch.") for tensor in state.values()}))
    holds = (
        f"backbone={name}" + ("" if parts["backbone"] else ", an initialisation of parts of it"),
        f"a style branch of placement={published.config(state)['placement']}" if "branch" in parts else "",
        "an addition to the style encoder" if "style_encoder" in parts else "",
        f"{len(state)} tensors, {count:,} parameters, {types}",
    )
    return Recognised(name, tuple(filter(None, holds)), published.without_prefix(state))


def checksum(path: Path) -> str:
    """The SHA-256 of a file, compared with that of the row of its name."""
    digest = sha256(path)
    for name, entry in weights.files().items():
        if entry.sha256 is not None and path.name == entry.file:
            if digest.startswith(entry.sha256):
                return f"{digest} (as published)"
            raise UserError(
                f"{path} has the SHA-256 {digest[:12]}…, and the published {name} {entry.sha256[:12]}…; get it "
                f"again from {entry.source}"
            )
    return f"{digest} (none is published)"
