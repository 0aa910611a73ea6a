"""What published checkpoints call our parameters, what their shapes tell, and strict loading."""

import logging
import math
import re
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Literal

from torch import Tensor, nn

from anystyle.contracts import Published
from anystyle.errors import UserError
from anystyle.injectors.zero_conv import ZeroConv
from anystyle.io.checkpoint import fill
from anystyle_backbones.published import checked_parts, count, decoder_options, dpt_rules, length, load_renamed, renamed

_log = logging.getLogger(__name__)

LAYOUT, PUBLISHER = "AnySplat and AnyStyle", "AnySplat's or AnyStyle's"
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
    """For each key of an :class:`~anystyle_backbones.anysplat.AnySplat`, its published name."""
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


class AnySplatCheckpoints(Published):
    """AnySplat's file, AnyStyle's checkpoints and VGGT's file."""

    def names(self, keys: Iterable[str]) -> dict[str, str]:
        return backbone_names(keys)

    def without_prefix(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The tensors under their publishers' names, without the prefixes of their file."""
        bare = {re.sub(r"^(model\.)?encoder\.", "", key): tensor for key, tensor in state.items()}
        checked_parts(
            bare,
            (*BACKBONE_PARTS, *BRANCH_PARTS, *VGGT_PARTS, TEXT_ADAPTER),
            publisher=PUBLISHER,
            advice="give the file of lhjiang/anysplat or a Lightning checkpoint of AnyStyle",
        )
        return bare

    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        names = self.without_prefix(state)
        options, placement = options_of(names), _placement(names)
        config = {f"backbone.{name}": value for name, value in options.items()}
        config |= {"placement": placement} if placement else {"branch.sh_degree": options.get("sh_degree", 0)}
        if any(name.startswith(TEXT_ADAPTER) for name in names):
            config["style_encoder.text_adapter"] = True
        return config

    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        """VGGT's file lacks the Gaussian head; AnyStyle's add a text adapter to the style encoder."""
        names = self.without_prefix(state)
        parts = {"backbone": any(name.startswith(GAUSSIANS) for name in names)}
        parts |= {"branch": True} if _placement(names) else {}
        return parts | ({"style_encoder": False} if any(name.startswith(TEXT_ADAPTER) for name in names) else {})

    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load a part from any of the files.

        Of VGGT's file, which is an initialisation, the Gaussian head stays as it is, and the log says so. A branch has
        ``zero_conv`` injectors, which take the widths of the checkpoint's.
        """
        loaders = {"backbone": _load_backbone, "branch": _load_branch, "style_encoder": _load_text_adapter}
        loaders[part](module, self.without_prefix(state))


def _placement(names: Mapping[str, Tensor]) -> Literal["head", "full"] | None:
    """The placement that a checkpoint's style branch was trained with; ``None`` if it holds no style branch."""
    if any(name.startswith("aggregator_injection.") for name in names):
        return "full"
    return "head" if any(name.startswith("gaussian_param_head_style.") for name in names) else None


def _load_backbone(backbone: nn.Module, state: Mapping[str, Tensor]) -> None:
    names = backbone_names(backbone.state_dict())
    given = {name: tensor for name, tensor in state.items() if name.startswith(BACKBONE_PARTS) and name not in UNUSED}
    if any(name.startswith(GAUSSIANS) for name in state):
        load_renamed(backbone, given, names, what="backbone", layout=LAYOUT)
    else:
        untouched = [key for key, name in names.items() if name.startswith(GAUSSIANS)]
        names = {key: name for key, name in names.items() if key not in untouched}
        load_renamed(backbone, given, names, what="backbone's part that VGGT initialises", layout=LAYOUT)
        _log.warning(
            "VGGT's file initialises %d of the backbone's %d tensors; left as they were: the %d of its Gaussian "
            "head (%s, …)",
            *(len(names), len(names) + len(untouched), len(untouched), ", ".join(untouched[:5])),
        )


def _load_branch(branch: nn.Module, state: Mapping[str, Tensor]) -> None:
    names = branch_names(branch.state_dict())
    given = {name: tensor for name, tensor in state.items() if name.startswith(BRANCH_PARTS)}
    injectors = branch.get_submodule("injectors")
    for site, injector in injectors.named_children():
        weight = state.get(names.get(f"injectors.{site}.fc.0.weight", ""))
        if isinstance(injector, ZeroConv) and weight is not None and weight.dim() == 2:
            injectors.register_module(site, _with_hidden(injector, weight))
    trained = _placement(state)
    what = "style branch" if trained else "style branch, and holds none of its own"
    layout = f"{LAYOUT}; it was trained with placement={trained}" if trained else LAYOUT
    load_renamed(branch, given, names, what=what, layout=layout)


def _with_hidden(injector: ZeroConv, weight: Tensor) -> ZeroConv:
    """An injector of the same options whose first layer has the shape of ``weight``."""
    first, projection = injector.get_submodule("fc.0").get_parameter("weight"), injector.zero_proj
    hidden, style_dim = weight.shape
    _check_style_dim(style_dim, first.shape[1])
    if hidden == first.shape[0]:
        return injector
    with first.device:
        resized = ZeroConv(
            dim=projection.in_features,
            style_dim=style_dim,
            hidden=hidden,
            gain=injector.gain,
            special_tokens=injector.special_tokens,
        )
    return resized.to(first.dtype)


def _check_style_dim(trained: int, given: int) -> None:
    if trained != given:
        raise UserError(
            f"the style branch was trained with embeddings of {trained} numbers, and the style encoder's have {given}; "
            "choose the encoder it was trained with (style_encoder=long_clip)"
        )


def _load_text_adapter(encoder: nn.Module, state: Mapping[str, Tensor]) -> None:
    given = {name.removeprefix(TEXT_ADAPTER): state[name] for name in state if name.startswith(TEXT_ADAPTER)}
    adapter = getattr(encoder, "adapter", None)
    expected = adapter.state_dict() if isinstance(adapter, nn.Module) else {}
    first = given.get("mlp.0.weight")
    if first is not None:
        _check_style_dim(first.shape[-1], getattr(encoder, "dim", 0))
    if {key: tensor.shape for key, tensor in expected.items()} != {key: tensor.shape for key, tensor in given.items()}:
        raise UserError(
            f"the checkpoint's text adapter has the tensors {sorted(given) or 'none'}, and the style encoder's "
            f"{sorted(expected) or 'none'}; choose style_encoder=long_clip "
            f"style_encoder.text_adapter={str(bool(given)).lower()}"
        )
    if isinstance(adapter, nn.Module):
        fill(adapter, given)


PUBLISHED_TAPS, PUBLISHED_DEPTH = (4, 11, 17, 23), 24


def options_of(names: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the :class:`~anystyle_backbones.anysplat.AnySplat` that a checkpoint fits.

    Which layers heads read cannot be seen: they are taken at the published fraction of the depth, rounded up. Heads of
    the camera head cannot either: there are as many as in the aggregator, as published.
    """
    of = partial(length, names, publisher=PUBLISHER)
    dim = of("aggregator.camera_token", 3)
    depth = count(names, "aggregator.frame_blocks.")
    heads = dim // of("aggregator.frame_blocks.0.attn.q_norm.weight", 0)
    patches = "aggregator.patch_embed."
    has_dino = any(name.startswith(f"{patches}blocks.") for name in names)
    patch_size = of(f"{patches}patch_embed.proj.weight" if has_dino else f"{patches}proj.weight", 3)
    options: dict[str, object] = {
        "patch_size": patch_size,
        "embed": "dino" if has_dino else "conv",
        "dim": dim,
        "depth": depth,
        "heads": heads,
        "mlp_ratio": of("aggregator.frame_blocks.0.mlp.fc1.weight", 0) / dim,
        "registers": of("aggregator.register_token", 2),
        "taps": tuple(math.ceil(layer * (depth - 1) / (PUBLISHED_DEPTH - 1)) for layer in PUBLISHED_TAPS),
        "camera_depth": count(names, "camera_head.trunk."),
        "camera_heads": heads,
    }
    if has_dino:
        options["native_resolution"] = math.isqrt(of(f"{patches}pos_embed", 1) - 1) * patch_size
        options["embed_depth"] = count(names, f"{patches}blocks.")
    for part, option in (("depth_head", "depth"), ("gaussian_param_head", "gaussian")):
        if option == "depth" or f"{part}.norm.weight" in names:
            options |= decoder_options(of, part, option)
            options[f"{option}_hidden"] = of(f"{part}.scratch.output_conv2.0.weight", 0)
    if "gaussian_features" in options:
        options["sh_degree"] = math.isqrt((of("gaussian_param_head.scratch.output_conv2.2.weight", 0) - 9) // 3) - 1
    return options
