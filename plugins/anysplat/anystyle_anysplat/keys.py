"""What published checkpoints call our parameters, what their shapes tell, and strict loading."""

import logging
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

from torch import Tensor, nn

from anystyle.nn.published import checked_parts, dpt_rules, length, load_renamed, numbers, renamed
from anystyle.published import Published
from anystyle.types import Site

_log = logging.getLogger(__name__)

LAYOUT = "AnySplat and AnyStyle"
PREFIXES = ("model.encoder.", "encoder.")
GAUSSIANS = "gaussian_param_head."
BACKBONE_PARTS = ("aggregator.", "camera_head.", "depth_head.", GAUSSIANS)
VGGT_PARTS = ("point_head.", "track_head.")
"""What VGGT's file holds and AnySplat drops."""
BRANCH_PARTS = ("aggregator_injection.", "gaussian_param_head_style.")
TEXT_ADAPTER = "text_adapter."
UNUSED = ("aggregator.patch_embed.mask_token",)
"""What the published network holds and never reads."""

_RULES = (
    (r"^embedder\.patches\.proj\.", "aggregator.patch_embed.patch_embed.proj."),
    (r"^embedder\.patches\.conv\.", "aggregator.patch_embed.proj."),
    (r"^embedder\.patches\.", "aggregator.patch_embed."),
    (r"^embedder\.", "aggregator."),
    (r"^geometry_head\.camera\.modulation\.", "camera_head.poseLN_modulation.1."),
    (r"^geometry_head\.camera\.", "camera_head."),
    (r"^geometry_head\.depth\.", "depth_head."),
    (r"^gaussian_head\.dpt\.", "gaussian_param_head."),
    (r"^gaussian_head\.direct\.", "gaussian_param_head.input_merger.0."),
    *dpt_rules("depth_head|gaussian_param_head"),
)
_COPIES = {"aggregator": "aggregator_injection", "gaussian_param_head": "gaussian_param_head_style"}


def backbone_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of an :class:`~anystyle_anysplat.AnySplat`, its published name."""
    return {key: renamed(key, _RULES) for key in keys}


def branch_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of a style branch on an AnySplat with ``zero_conv`` injectors, its published name.

    Injectors of the aggregator are numbered in the order of their layers.
    """
    keys = list(keys)
    layers = sorted({int(match[1]) for key in keys if (match := re.match(r"injectors\.aggregator/(\d+)\.", key))})
    return {key: _branch_name(key, layers) for key in keys}


def _branch_name(key: str, layers: list[int]) -> str:
    if match := re.match(r"injectors\.aggregator/(\d+)\.(.*)", key):
        return f"aggregator_injection.style_injector_aggregator.{layers.index(int(match[1]))}.{match[2]}"
    if match := re.match(r"injectors\.head/tokens/(\d+)\.(.*)", key):
        return f"gaussian_param_head_style.style_injector_aggregator.{match[1]}.{match[2]}"
    if match := re.match(r"injectors\.head/direct\.(.*)", key):
        return f"gaussian_param_head_style.style_injector_direct.{match[1]}"
    part, _, rest = renamed(key, _RULES).partition(".")
    return f"{_COPIES.get(part, part)}.{rest}"


class Checkpoints(Published):
    """AnySplat's file, AnyStyle's checkpoints and VGGT's file."""

    def without_prefix(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """See :meth:`Published.without_prefix`.

        Raises:
            ValueError: A key has none of the files' prefixes.
        """
        bare: dict[str, Tensor] = {}
        for key, tensor in state.items():
            bare[next((key.removeprefix(prefix) for prefix in PREFIXES if key.startswith(prefix)), key)] = tensor
        checked_parts(
            bare,
            (*BACKBONE_PARTS, *BRANCH_PARTS, *VGGT_PARTS, TEXT_ADAPTER),
            publisher="AnySplat's or AnyStyle's",
            advice="give the file of lhjiang/anysplat or a Lightning checkpoint of AnyStyle",
        )
        return bare

    def complete(self, state: Mapping[str, Tensor]) -> bool:
        """Whether a state dict holds all of AnySplat; VGGT's lacks the Gaussian head."""
        return any(name.startswith(GAUSSIANS) for name in self.without_prefix(state))

    def options(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        return options_of(self.without_prefix(state))

    def placement(self, state: Mapping[str, Tensor]) -> Literal["head", "full"] | None:
        """The placement that a checkpoint's style branch was trained with; ``None`` if it holds no style branch."""
        names = self.without_prefix(state)
        if any(name.startswith("aggregator_injection.") for name in names):
            return "full"
        return "head" if any(name.startswith("gaussian_param_head_style.") for name in names) else None

    def injector_options(self, state: Mapping[str, Tensor], sites: Sequence[Site]) -> dict[str, dict[str, int]]:
        """Widths of the injectors in a checkpoint, by site; empty without a style branch."""
        names = self.without_prefix(state)
        layers = sorted(int(site.name.rpartition("/")[2]) for site in sites if site.name.startswith("aggregator/"))
        options: dict[str, dict[str, int]] = {}
        for site in sites:
            weight = names.get(_branch_name(f"injectors.{site.name}.fc.0.weight", layers))
            if weight is not None and weight.dim() == 2:
                options[site.name] = {"hidden": weight.shape[0], "style_dim": weight.shape[1]}
        return options

    def text_adapter(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The text adapter of an AnyStyle checkpoint, keys ``mlp.…``; empty for AnySplat's file."""
        names = self.without_prefix(state)
        return {name.removeprefix(TEXT_ADAPTER): names[name] for name in names if name.startswith(TEXT_ADAPTER)}

    def load_backbone(self, backbone: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load AnySplat's weights from any of the files into a backbone of the same options.

        Of VGGT's file, which is an initialisation, the Gaussian head stays as it is, and the log says so.

        Raises:
            ValueError: Keys or shapes differ; up to five of each kind of difference are named.
        """
        names, what = backbone_names(backbone.state_dict()), "backbone"
        given = {
            name: tensor
            for name, tensor in self.without_prefix(state).items()
            if name.startswith(BACKBONE_PARTS) and name not in UNUSED
        }
        untouched: list[str] = []  # keys that stay as they are
        if not self.complete(state):
            what = "backbone's part that VGGT initialises"
            untouched = [key for key, name in names.items() if name.startswith(GAUSSIANS)]
            names = {key: name for key, name in names.items() if key not in untouched}
        load_renamed(backbone, given, names, what=what, layout=LAYOUT)
        if untouched:
            _log.warning(
                "VGGT's file initialises %d of the backbone's %d tensors; left as they were: the %d of its Gaussian "
                "head (%s, …)",
                *(len(names), len(names) + len(untouched), len(untouched), ", ".join(untouched[:5])),
            )

    def load_branch(self, branch: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load the style branch of an AnyStyle checkpoint into one of the same placement, with ``zero_conv`` injectors.

        Raises:
            ValueError: Keys or shapes differ; up to five of each kind of difference are named.
        """
        names = branch_names(branch.state_dict())
        given = {name: tensor for name, tensor in self.without_prefix(state).items() if name.startswith(BRANCH_PARTS)}
        trained = self.placement(state)
        what = "style branch" if trained else "style branch, and holds none of its own"
        layout = f"{LAYOUT}; it was trained with placement={trained}" if trained else LAYOUT
        load_renamed(branch, given, names, what=what, layout=layout)


PUBLISHED_TAPS = (4, 11, 17, 23)
PUBLISHED_DEPTH = 24


def options_of(names: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the :class:`~anystyle_anysplat.AnySplat` that a checkpoint fits.

    Which layers heads read cannot be seen: they are taken at the published fraction of the depth, rounded up. Heads of
    the camera head cannot either: there are as many as in the aggregator, as published.

    Args:
        names: Tensors under published names, without prefixes.

    Raises:
        ValueError: A tensor is missing, or is no weight of such a network.
    """
    dim = _length(names, "aggregator.camera_token", 3)
    patches = "aggregator.patch_embed."
    has_dino = any(name.startswith(f"{patches}blocks.") for name in names)
    patch_size = _length(names, f"{patches}patch_embed.proj.weight" if has_dino else f"{patches}proj.weight", 3)
    depth = _count(names, "aggregator.frame_blocks.")
    heads = dim // _length(names, "aggregator.frame_blocks.0.attn.q_norm.weight", 0)
    options: dict[str, object] = {
        "patch_size": patch_size,
        "embed": "dino" if has_dino else "conv",
        "dim": dim,
        "depth": depth,
        "heads": heads,
        "mlp_ratio": _length(names, "aggregator.frame_blocks.0.mlp.fc1.weight", 0) / dim,
        "registers": _length(names, "aggregator.register_token", 2),
        "taps": taps(depth),
        "camera_depth": _count(names, "camera_head.trunk."),
        "camera_heads": heads,
        **_decoder(names, "depth_head.", "depth"),
    }
    if has_dino:
        options["native_resolution"] = math.isqrt(_length(names, f"{patches}pos_embed", 1) - 1) * patch_size
        options["embed_depth"] = _count(names, f"{patches}blocks.")
    if "gaussian_param_head.norm.weight" in names:
        options |= _decoder(names, "gaussian_param_head.", "gaussian")
        outputs = _length(names, "gaussian_param_head.scratch.output_conv2.2.weight", 0)
        options["sh_degree"] = math.isqrt((outputs - 9) // 3) - 1
    return options


def taps(depth: int) -> tuple[int, ...]:
    """The published layers of 24, at the same fraction of another depth."""
    return tuple(math.ceil(layer * (depth - 1) / (PUBLISHED_DEPTH - 1)) for layer in PUBLISHED_TAPS)


def _decoder(names: Mapping[str, Tensor], part: str, option: str) -> dict[str, object]:
    return {
        f"{option}_features": _length(names, f"{part}scratch.layer1_rn.weight", 0),
        f"{option}_channels": tuple(_length(names, f"{part}projects.{level}.weight", 0) for level in range(4)),
        f"{option}_hidden": _length(names, f"{part}scratch.output_conv2.0.weight", 0),
    }


def _length(names: Mapping[str, Tensor], name: str, axis: int) -> int:
    return length(names, name, axis, publisher="AnySplat's or AnyStyle's")


def _count(names: Mapping[str, Tensor], prefix: str) -> int:
    return len(numbers(names, re.escape(prefix) + r"(\d+)\."))
