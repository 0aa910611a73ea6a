"""What ``anystyle weights verify`` and ``convert`` share: a file of weights, its kind told from its keys."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from omegaconf import OmegaConf
from torch import Tensor

from anystyle.contracts import Backbone, StyleEncoder
from anystyle.inference.assemble import build_and_load, make_branch, published_by
from anystyle.inference.weights import reference_config
from anystyle.io.checkpoint import Header, differences, has_header, read_header, sha256
from anystyle.perception import NETWORKS, weights
from anystyle.perception.state_dict_formats import LAYOUTS, layout_of
from anystyle.registry.build import build
from anystyle.registry.catalog import PluginError, catalog

State = Mapping[str, Tensor]


@dataclass(frozen=True)
class Known:
    """A file of weights that was recognised and found whole.

    Args:
        layout: Its kind: ``anystyle``, a key of :data:`LAYOUTS`, or a backbone of the catalog.
        holds: What is in it, one line each.
        state: Its tensors as they are kept: without a file's prefixes and what training left behind.
    """

    layout: str
    holds: tuple[str, ...]
    state: State


def existing(name: str) -> Path:
    """The file of a path, or of a row of the table.

    Raises:
        ValueError: There is none.
        FileNotFoundError: The row's file is nowhere.
    """
    path = weights.find(name) if name in weights.files() else Path(name).expanduser()
    if not path.is_file():
        raise ValueError(f"there is no file {path}; name a file, or a row of `anystyle weights`")
    return path


def recognise(path: Path) -> Known:
    """Tell what a file holds, and judge it strictly.

    Raises:
        ValueError: It is truncated, of no known kind, or not whole; one line says what is wrong.
    """
    if has_header(path):
        header = read_header(path)
        state = weights.read(path)
        _check_ours(path, header, state)
        provenance = ", ".join(f"{key} {value}" for key, value in header.provenance.items())
        return Known(
            "anystyle", (f"{header.part} that anystyle wrote{f' ({provenance})' if provenance else ''}",), state
        )
    state = weights.read(path)
    _check_finite(path, state)
    name = layout_of(state)
    if name is not None:
        LAYOUTS[name].check(path, state)
        return Known(name, (LAYOUTS[name].about,), LAYOUTS[name].names(state))
    for backbone in catalog().names("backbone"):
        known = _of_backbone(backbone, state)
        if known is not None:
            return known
    names = ", ".join(list(state)[:5])
    raise ValueError(
        f"{path} is of no known kind: {len(state)} tensors, such as {names}; known are {', '.join(LAYOUTS)} and the "
        "checkpoints of backbones"
    )


def _check_ours(path: Path, header: Header, state: State) -> None:
    """Load a file that anystyle wrote into the network that its header describes, without memory for it."""
    _check_finite(path, state)
    if header.part in (*NETWORKS, "backbone", "style_encoder", "branch"):
        config = OmegaConf.create(header.config)
        with torch.device("meta"):
            if header.part in NETWORKS:
                module = NETWORKS[header.part]()
            elif header.part == "backbone":
                module = build(Backbone, config.get("backbone", {}))
            elif header.part == "style_encoder":
                module = build(StyleEncoder, config.get("style_encoder", {}))
            else:
                encoder = build(StyleEncoder, config.get("style_encoder", {}))
                module = make_branch(config, build(Backbone, config.get("backbone", {})), encoder.dim)
        expected = {key: tensor for key, tensor in module.state_dict().items() if not header.omits(key)}
        unlike = differences(expected, state)
        if unlike:
            raise ValueError(f"{path} does not fit the {header.part} that its header describes: {unlike}")
    elif not any(row.file == path.name and row.sha256 == sha256(path) for row in weights.files().values()):
        known = ", ".join(("backbone", "style_encoder", "branch", *NETWORKS))
        raise ValueError(f"{path} holds a part {header.part[:80]!r}, which nothing is made of; known are {known}")


def _check_finite(path: Path, state: State) -> None:
    for key, tensor in state.items():
        if tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            raise ValueError(f"{path} is damaged: {key} holds values that are infinite or no numbers")


def _of_backbone(name: str, state: State) -> Known | None:
    """What a backbone's plugin says of a state dict; ``None`` where it is of another network."""
    try:
        loaded = catalog().find("backbone", name).load()
        published = loaded.published if issubclass(loaded, Backbone) else None
        if published is None:
            return None
        published.options(state)
    except (PluginError, ValueError):
        return None
    config = reference_config(state, [f"backbone={name}"])
    published = published_by(config)
    placement = published.placement(state)
    if published.complete(state):
        parts = {"backbone": state} | ({"branch": state} if placement else {})
        build_and_load(config, {}, parts)
    else:
        with torch.device("meta"):
            backbone = build(Backbone, config.backbone)
        published.load_backbone(backbone, state)
    count = sum(tensor.numel() for tensor in state.values())
    types = ", ".join(sorted({str(tensor.dtype).removeprefix("torch.") for tensor in state.values()}))
    holds = [f"backbone={name}" + ("" if published.complete(state) else ", an initialisation of parts of it")]
    holds += [f"a style branch of placement={placement}"] if placement else []
    holds += ["a text adapter"] if published.text_adapter(state) else []
    return Known(
        name, (*holds, f"{len(state)} tensors, {count:,} parameters, {types}"), published.without_prefix(state)
    )


def checksum(path: Path) -> str:
    """The SHA-256 of a file, and whether it is the one that a row of the same file name states.

    Raises:
        ValueError: It is another.
    """
    digest = sha256(path)
    for name, entry in weights.files().items():
        if entry.sha256 is not None and path.name == entry.file:
            if not digest.startswith(entry.sha256):
                raise ValueError(
                    f"{path} has the SHA-256 {digest[:12]}…, and the published {name} {entry.sha256[:12]}…; get it "
                    f"again from {entry.source}"
                )
            return f"{digest} (as published)"
    return f"{digest} (none is published)"
