"""What the shapes of a published checkpoint tell of the network that they belong to."""

import math
import re
from collections.abc import Mapping

from torch import Tensor

from anystyle.nn.published import length, numbers

PUBLISHED_TAPS = (4, 11, 17, 23)
PUBLISHED_DEPTH = 24


def options(names: Mapping[str, Tensor]) -> dict[str, object]:
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
