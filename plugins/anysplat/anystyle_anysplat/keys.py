"""The published checkpoints' names for our parameters, and strict loading by them.

Three files are known: AnySplat's (keys ``encoder.…``, 1405 of them); AnyStyle's Lightning checkpoints (keys
``model.encoder.…``), which hold AnySplat and a style branch; and VGGT's (keys without a prefix), which AnySplat's
training starts from. Names here are without prefixes. This module is what
:class:`anystyle.contracts.Published` asks for.
"""

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from torch import Tensor, nn

from anystyle.paging import fill
from anystyle.types import Site
from anystyle_anysplat import shapes

_log = logging.getLogger(__name__)

PREFIXES = ("model.encoder.", "encoder.")
BACKBONE_PARTS = ("aggregator.", "camera_head.", "depth_head.", "gaussian_param_head.")
VGGT_PARTS = ("point_head.", "track_head.")
"""What VGGT's file holds and AnySplat drops."""
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
    known = (*BACKBONE_PARTS, *BRANCH_PARTS, *VGGT_PARTS, TEXT_ADAPTER)
    foreign = [name for name in bare if not name.startswith(known)]
    if foreign or not bare:
        raise ValueError(
            f"the checkpoint has {len(foreign)} keys that are neither AnySplat's nor AnyStyle's ({_some(foreign)}); "
            "give the file of lhjiang/anysplat or a Lightning checkpoint of AnyStyle"
        )
    return bare


def complete(state: Mapping[str, Tensor]) -> bool:
    """Whether a state dict holds all of AnySplat; VGGT's lacks the Gaussian head."""
    return not _of_vggt(without_prefix(state))


def _of_vggt(names: Mapping[str, Tensor]) -> bool:
    return "gaussian_param_head." not in {name[: name.find(".") + 1] for name in names}


def options(state: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the :class:`~anystyle_anysplat.AnySplat` whose weights these are; see :mod:`anystyle_anysplat.shapes`.

    Raises:
        ValueError: Tensors are missing that sizes are read off.
    """
    return shapes.options(without_prefix(state))


def injector_options(state: Mapping[str, Tensor], sites: Sequence[Site]) -> dict[str, dict[str, int]]:
    """Widths of the injectors in a checkpoint, by site; empty without a style branch."""
    names = without_prefix(state)
    layers = sorted(int(site.name.rpartition("/")[2]) for site in sites if site.name.startswith("aggregator/"))
    found: dict[str, dict[str, int]] = {}
    for site in sites:
        weight = names.get(_published_branch(f"injectors.{site.name}.fc.0.weight", layers))
        if weight is not None and weight.dim() == 2:
            found[site.name] = {"hidden": weight.shape[0], "style_dim": weight.shape[1]}
    return found


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
    """Load AnySplat's weights from any of the files into a backbone of the same options.

    Of VGGT's file, which is an initialisation, the Gaussian head stays as it is, and the log says so.

    Raises:
        ValueError: Keys or shapes differ; up to five of each kind of difference are named.
    """
    own = backbone.state_dict()
    given = without_prefix(state)
    initialisation = _of_vggt(given)
    chosen = {name: tensor for name, tensor in given.items() if name.startswith(BACKBONE_PARTS) and name not in UNUSED}
    names, what = backbone_names(own), "backbone"
    if initialisation:
        what = "backbone's part that VGGT initialises"
        names = {key: name for key, name in names.items() if not name.startswith("gaussian_param_head.")}
    fill(backbone, _matched(chosen, own, names, what))
    if initialisation:
        left = [key for key in own if key not in names]
        _log.warning(
            "VGGT's file initialises %d of the backbone's %d tensors; left as they were: the %d of its Gaussian head "
            "(%s)",
            *(len(names), len(own), len(left), _some(left)),
        )


def load_branch(branch: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Load the style branch of an AnyStyle checkpoint into one of the same placement, with ``zero_conv`` injectors.

    Raises:
        ValueError: Keys or shapes differ; up to five of each kind of difference are named.
    """
    own = branch.state_dict()
    chosen = {name: tensor for name, tensor in without_prefix(state).items() if name.startswith(BRANCH_PARTS)}
    trained = placement(state)
    what = "style branch" if trained else "style branch, and holds none of its own"
    hint = f"; it was trained with placement={trained}" if trained else ""
    fill(branch, _matched(chosen, own, branch_names(own), what, hint))


def _matched(
    state: Mapping[str, Tensor], own: Mapping[str, Tensor], names: Mapping[str, str], what: str, hint: str = ""
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
        raise ValueError(
            f"the checkpoint does not fit this {what}: {'; '.join(differences)}{hint} "
            f"(expected: {len(names)} tensors in the layout of AnySplat and AnyStyle)"
        )
    return {key: state[name].reshape(own[key].shape) for key, name in names.items()}


def _squeezed(tensor: Tensor) -> Tensor:
    """A weight without the unit axes of a 1x1 convolution, which is a linear map here."""
    return tensor.flatten(1) if tensor.dim() > 2 and set(tensor.shape[2:]) == {1} else tensor


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
