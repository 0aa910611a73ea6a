"""The published checkpoints' names for our parameters, and strict loading by them.

Two files are known: AnySplat's (keys ``encoder.…``, 1405 of them) and AnyStyle's Lightning checkpoints (keys
``model.encoder.…``), which hold AnySplat and a style branch. Names here are without those prefixes.
"""

import re
from collections.abc import Iterable, Mapping
from typing import Literal

import torch
from torch import Tensor, nn

PREFIXES = ("model.encoder.", "encoder.")
BACKBONE_PARTS = ("aggregator.", "camera_head.", "depth_head.", "gaussian_param_head.")
BRANCH_PARTS = ("aggregator_injection.", "gaussian_param_head_style.")
TEXT_ADAPTER = "text_adapter."
UNUSED = ("aggregator.patch_embed.mask_token",)
"""What the published network holds and never reads."""

_DPT = (
    (r"\bresize\.(\d)", r"resize_layers.\1"),
    (r"\bneck\.", "scratch.output_conv1."),
    (r"\boutput\.", "scratch.output_conv2."),
    (r"\blevel\.", "resConfUnit1."),
    (r"\brefine\.", "resConfUnit2."),
    (r"\bproject\.", "out_conv."),
)
_PARTS = (
    (r"^embedder\.patches\.proj\.", "aggregator.patch_embed.patch_embed.proj."),
    (r"^embedder\.patches\.conv\.", "aggregator.patch_embed.proj."),
    (r"^embedder\.patches\.", "aggregator.patch_embed."),
    (r"^embedder\.", "aggregator."),
    (r"^geometry_head\.camera\.modulation\.", "camera_head.poseLN_modulation.1."),
    (r"^geometry_head\.camera\.", "camera_head."),
    (r"^geometry_head\.depth\.", "depth_head."),
    (r"^gaussian_head\.dpt\.", "gaussian_param_head."),
    (r"^gaussian_head\.direct\.", "gaussian_param_head.input_merger.0."),
)

_COPIES = {"aggregator": "aggregator_injection", "gaussian_param_head": "gaussian_param_head_style"}


def backbone_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of an :class:`~anystyle_anysplat.AnySplat`, its published name."""
    return {key: _published(key) for key in keys}


def branch_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of a style branch on an AnySplat with ``zero_conv`` injectors, its published name.

    Injectors of the aggregator are numbered in the order of their layers.
    """
    keys = list(keys)
    layers = sorted({int(found[1]) for key in keys if (found := re.match(r"injectors\.aggregator/(\d+)\.", key))})
    return {key: _published_branch(key, layers) for key in keys}


def _published(key: str) -> str:
    for pattern, replacement in _PARTS:
        name, count = re.subn(pattern, replacement, key)
        if count:
            return _published_decoder(name) if "head.dpt." in key or "head.depth." in key else name
    return key


def _published_decoder(name: str) -> str:
    # Levels count from 0 here and from 1 there.
    name = re.sub(r"\breduce\.(\d)", lambda found: f"scratch.layer{int(found[1]) + 1}_rn", name)
    name = re.sub(r"\bfusions\.(\d)", lambda found: f"scratch.refinenet{int(found[1]) + 1}", name)
    for pattern, replacement in _DPT:
        name = re.sub(pattern, replacement, name)
    return name


def _published_branch(key: str, layers: list[int]) -> str:
    if found := re.match(r"injectors\.aggregator/(\d+)\.(.*)", key):
        return f"aggregator_injection.style_injector_aggregator.{layers.index(int(found[1]))}.{found[2]}"
    if found := re.match(r"injectors\.head/tokens/(\d+)\.(.*)", key):
        return f"gaussian_param_head_style.style_injector_aggregator.{found[1]}.{found[2]}"
    if found := re.match(r"injectors\.head/direct\.(.*)", key):
        return f"gaussian_param_head_style.style_injector_direct.{found[1]}"
    part, _, rest = _published(key).partition(".")
    return f"{_COPIES.get(part, part)}.{rest}"


def without_prefix(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A published state dict with names as here, whichever of the two files it comes from.

    Raises:
        ValueError: A key has neither file's prefix.
    """
    bare: dict[str, Tensor] = {}
    for key, tensor in state.items():
        name = next((key.removeprefix(prefix) for prefix in PREFIXES if key.startswith(prefix)), key)
        bare[name] = tensor
    known = (*BACKBONE_PARTS, *BRANCH_PARTS, TEXT_ADAPTER)
    foreign = [name for name in bare if not name.startswith(known)]
    if foreign:
        raise ValueError(
            f"the checkpoint has {len(foreign)} keys that are neither AnySplat's nor AnyStyle's ({_some(foreign)}); "
            "give the file of lhjiang/anysplat or a Lightning checkpoint of AnyStyle"
        )
    return bare


def placement(state: Mapping[str, Tensor]) -> Literal["head", "full"] | None:
    """The placement that a checkpoint's style branch was trained with; ``None`` if it holds no style branch."""
    names = without_prefix(state)
    if any(name.startswith("aggregator_injection.") for name in names):
        return "full"
    return "head" if any(name.startswith("gaussian_param_head_style.") for name in names) else None


def text_adapter(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The text adapter of an AnyStyle checkpoint, keys ``mlp.…``; it belongs to the style encoder.

    Empty for AnySplat's file.
    """
    names = without_prefix(state)
    return {name.removeprefix(TEXT_ADAPTER): names[name] for name in names if name.startswith(TEXT_ADAPTER)}


def load_backbone(backbone: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Load AnySplat's weights from either file into a backbone of the same options.

    Raises:
        ValueError: Keys or shapes differ; up to five of each kind of difference are named.
    """
    own = backbone.state_dict()
    chosen = {
        name: tensor
        for name, tensor in without_prefix(state).items()
        if name.startswith(BACKBONE_PARTS) and name not in UNUSED
    }
    _load(backbone, _matched(chosen, own, backbone_names(own), "backbone"))


def load_branch(branch: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Load the style branch of an AnyStyle checkpoint into one of the same placement, with ``zero_conv`` injectors.

    Raises:
        ValueError: Keys or shapes differ; up to five of each kind of difference are named.
    """
    own = branch.state_dict()
    chosen = {name: tensor for name, tensor in without_prefix(state).items() if name.startswith(BRANCH_PARTS)}
    _load(branch, _matched(chosen, own, branch_names(own), "style branch"))


def _matched(
    state: Mapping[str, Tensor], own: Mapping[str, Tensor], names: Mapping[str, str], what: str
) -> dict[str, Tensor]:
    published = set(names.values())
    missing = [name for name in names.values() if name not in state]
    extra = [name for name in state if name not in published]
    misshapen = [
        f"{name} is {list(state[name].shape)}, not {list(own[key].shape)}"
        for key, name in names.items()
        if name in state and _squeezed(state[name]).shape != _squeezed(own[key]).shape
    ]
    differences = [
        f"{len(found)} {kind} ({_some(found)})"
        for kind, found in (("missing", missing), ("unexpected", extra), ("misshapen", misshapen))
        if found
    ]
    if differences:
        raise ValueError(f"the checkpoint does not fit this {what}: {'; '.join(differences)}")
    return {key: state[name].reshape(own[key].shape).to(own[key].dtype) for key, name in names.items()}


def _squeezed(tensor: Tensor) -> Tensor:
    """A weight without the unit axes of a 1x1 convolution, which is a linear map here."""
    return tensor.flatten(1) if tensor.dim() > 2 and set(tensor.shape[2:]) == {1} else tensor


@torch.no_grad()
def _load(module: nn.Module, state: dict[str, Tensor]) -> None:
    # A module on the meta device has no memory to copy into: it takes the tensors themselves.
    module.load_state_dict(state, assign=any(tensor.is_meta for tensor in module.state_dict().values()))


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
