"""The published checkpoint's names for our parameters, what its shapes tell, and strict loading.

The file of ``facebook/map-anything-apache`` on Hugging Face, version 1.1, without Gaussian head or style branch.
"""

import math
import re
from collections.abc import Iterable, Mapping
from functools import partial

from torch import Tensor, nn

from anystyle.contracts import Published
from anystyle.errors import UserError
from anystyle_backbones.published import checked_parts, count, first_names, fusion_rules, length, load_renamed, renamed

LAYOUT, PUBLISHER = "MapAnything, version 1.1; choose backbone=mapanything", "MapAnything 1.1's"
ENCODER, SHARING, DENSE = "encoder.model.", "info_sharing.", "dense_head."
UNUSED = {
    r"ray_dirs_encoder\.": "reads known lenses, which no embedder here is given",
    r"depth_(scale_)?encoder\.": "reads known depth",
    r"cam_(rot|trans|trans_scale)_encoder\.": "reads known poses",
}
"""Published tensors without a place here, by regular expression, and why."""
PARTS = (ENCODER, SHARING, DENSE, "pose_head.", "scale_head.", "scale_token", "fusion_norm_layer.")
OTHERS = ("ray_dirs_encoder.", "depth_encoder.", "depth_scale_encoder.", "cam_rot_encoder.", "cam_trans_")
MARK = f"{SHARING}self_attention_blocks.0.mlp.w12.weight"
"""A tensor that files of version 1 do not have."""

_SECOND = (
    (r"^dpt_feature_head\.", f"{DENSE}0."),
    (r"^dpt_regressor_head\.", f"{DENSE}1."),
    (r"\.scratch\.layer_rn\.(\d)\.", r".input_process.\1.1."),
    *((rf"\.scratch\.layer{level + 1}_rn\.", f".input_process.{level}.1.") for level in range(4)),
)
"""From second names, of which the published module has 76 and a file of safetensors keeps none, to the first."""
_RULES = (
    (r"^embedder\.proj\.", f"{ENCODER}patch_embed.proj."),
    (r"^embedder\.norm\.", "fusion_norm_layer."),
    (r"^embedder\.", ENCODER),
    (r"^aggregator\.scale_token", "scale_token"),
    (r"^aggregator\.reference", f"{SHARING}view_pos_table"),
    (r"^aggregator\.blocks\.", f"{SHARING}self_attention_blocks."),
    (r"^aggregator\.", SHARING),
    *(
        (rf"^geometry_head\.pose\.residuals\.(\d)\.{2 * n}\.", rf"pose_head.res_conv.\1.res_conv{n + 1}.")
        for n in range(3)
    ),
    (r"^geometry_head\.pose\.mlp\.", "pose_head.more_mlps."),
    (r"^geometry_head\.pose\.translation\.", "pose_head.fc_t."),
    (r"^geometry_head\.pose\.quaternion\.", "pose_head.fc_rot."),
    (r"^geometry_head\.pose\.", "pose_head."),
    (r"^geometry_head\.scale\.0\.", "scale_head.proj."),
    (r"^geometry_head\.scale\.1\.", "scale_head.mlp.0.0."),
    (r"^geometry_head\.scale\.3\.", "scale_head.mlp.1.0."),
    (r"^geometry_head\.scale\.5\.", "scale_head.output_proj."),
    (r"^geometry_head\.dense\.projects\.(\d)\.", rf"{DENSE}0.input_process.\1.0.0."),
    (r"^geometry_head\.dense\.resize\.(\d)\.", rf"{DENSE}0.input_process.\1.0.1."),
    (r"^geometry_head\.dense\.reduce\.(\d)\.", rf"{DENSE}0.input_process.\1.1."),
    (r"^geometry_head\.dense\.neck\.", f"{DENSE}1.conv1."),
    (r"^geometry_head\.dense\.output\.", f"{DENSE}1.conv2."),
    (r"^geometry_head\.dense\.", f"{DENSE}0."),
    *fusion_rules(r"dense_head\.0"),
)


def backbone_names(keys: Iterable[str]) -> dict[str, str]:
    """For each published key of a :class:`~anystyle_backbones.mapanything.MapAnything`, its published name."""
    return {key: renamed(key, _RULES) for key in keys if not key.startswith("gaussian_head.")}


class MapAnythingCheckpoints(Published):
    """The file of MapAnything, version 1.1."""

    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        options = options_of(_checked(state))
        return {f"backbone.{name}": value for name, value in options.items()} | {"branch.sh_degree": 0}

    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        """It has no Gaussian head."""
        _checked(state)
        return {"backbone": False}

    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load the file into a backbone of the same options; the Gaussian head stays as it is."""
        if part != "backbone":
            raise UserError("the checkpoint holds no style branch; give one that anystyle trained, or null")
        unused = re.compile("|".join(UNUSED))
        given = {name: tensor for name, tensor in _checked(state).items() if not unused.match(name)}
        load_renamed(module, given, backbone_names(module.state_dict()), what="backbone", layout=LAYOUT)


def _checked(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors by their first names."""
    first = first_names(state, _SECOND)
    advice = "give the file of facebook/map-anything-apache, version 1.1"
    checked_parts(first, PARTS + OTHERS, publisher=PUBLISHER, advice=advice)
    if MARK not in first:
        raise UserError(f"the checkpoint has no {MARK}: it is not {PUBLISHER}; {advice}")
    return first


def options_of(state: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the backbone, as far as shapes tell: not the layers that heads read.

    An attention head has 64 channels, as published; the Gaussian head, which is not, is like the dense one.
    """
    of = partial(length, state, publisher=PUBLISHER)
    dim, patch_size = (of(f"{ENCODER}patch_embed.proj.weight", axis) for axis in (0, 3))
    features = of(f"{DENSE}1.conv1.weight", 1)
    channels = tuple(of(f"{DENSE}0.input_process.{level}.0.0.weight", 0) for level in range(4))
    return {
        "patch_size": patch_size,
        "native_resolution": patch_size * math.isqrt(of(f"{ENCODER}pos_embed", 1) - 1),
        "dim": dim,
        "embed_depth": count(state, f"{ENCODER}blocks."),
        "depth": count(state, f"{SHARING}self_attention_blocks."),
        "heads": max(1, dim // 64),
        "depth_features": features,
        "depth_channels": channels,
        "depth_hidden": of(f"{DENSE}1.conv2.0.weight", 0),
        "pose_hidden": of("pose_head.proj.weight", 0),
        "gaussian_features": features,
        "gaussian_channels": channels,
    }
