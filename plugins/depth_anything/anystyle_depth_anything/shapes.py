"""What the shapes of published weights tell of the network they belong to."""

import re
from collections.abc import Mapping
from math import isqrt

from torch import Tensor

from anystyle.nn.published import length, numbers

TAPS = {12: (5, 7, 9, 11), 24: (11, 15, 19, 23), 40: (19, 27, 33, 39)}
"""The layers that heads read, by the published depth of the trunk: shapes do not tell them."""


def options(state: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the backbone, as far as shapes tell.

    Without a Gaussian head in it, they are of a network whose head is like the depth head and not yet trained.

    Raises:
        ValueError: Tensors are missing that sizes are read off.
    """
    return _trunk(state) | _decoder(state, "head", "depth") | _gaussians(state)


def _trunk(state: Mapping[str, Tensor]) -> dict[str, object]:
    trunk = "backbone.pretrained."
    dim, patch_size = (_length(state, f"{trunk}patch_embed.proj.weight", axis) for axis in (0, 3))
    start = min(numbers(state, rf"{re.escape(trunk)}blocks\.(\d+)\.attn\.q_norm\."), default=0)
    depth = len(numbers(state, rf"{re.escape(trunk)}blocks\.(\d+)\."))
    head_dim = _length(state, f"{trunk}blocks.{start}.attn.q_norm.weight", 0)
    gated = f"{trunk}blocks.0.mlp.w12.weight" in state
    options: dict[str, object] = {
        "patch_size": patch_size,
        "native_resolution": patch_size * isqrt(_length(state, f"{trunk}pos_embed", 1) - 1),
        "dim": dim,
        "depth": depth,
        "heads": dim // head_dim,
        "ffn": "swiglu" if gated else "mlp",
        "alternate_from": start,
        "camera_encoder_depth": len(numbers(state, r"cam_enc\.trunk\.(\d+)\.")),
        "rays": "head.scratch.refinenet1_aux.out_conv.weight" in state,
    }
    if not gated:
        options["mlp_ratio"] = _length(state, f"{trunk}blocks.0.mlp.fc1.weight", 0) / dim
    if depth in TAPS:
        options["taps"] = TAPS[depth]
    return options


def _decoder(state: Mapping[str, Tensor], part: str, name: str) -> dict[str, object]:
    return {
        f"{name}_features": _length(state, f"{part}.scratch.output_conv1.weight", 1),
        f"{name}_channels": tuple(_length(state, f"{part}.projects.{level}.weight", 0) for level in range(4)),
    }


def _gaussians(state: Mapping[str, Tensor]) -> dict[str, object]:
    outputs = "gs_head.scratch.output_conv2.2.weight"
    if outputs not in state:
        untrained = {"depth_along": "z", "rotations": "camera", "init": "scratch"}
        return _decoder(state, "head", "gaussian") | untrained
    degree = isqrt((_length(state, outputs, 0) - 11) // 3) - 1
    return {"sh_degree": degree} | _decoder(state, "gs_head", "gaussian")


def _length(state: Mapping[str, Tensor], name: str, axis: int) -> int:
    return length(state, name, axis, publisher="Depth Anything 3's")
