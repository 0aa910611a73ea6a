"""The published checkpoint's names for our parameters, what its shapes tell, and strict loading.

The file of ``tencent/HunyuanWorld-Mirror`` on Hugging Face. No style branch is published for this network.
"""

import math
import re
from collections.abc import Iterable, Mapping
from functools import partial

from torch import Tensor, nn

from anystyle.contracts import Published
from anystyle.errors import UserError
from anystyle_backbones.published import checked_parts, count, decoder_options, dpt_rules, length, load_renamed, renamed

LAYOUT, PUBLISHER = "WorldMirror, version 1", "WorldMirror's"
TRUNK, RENDERER = "visual_geometry_transformer.", "gs_renderer.gs_head."
PARTS = (TRUNK, "cam_head.", "depth_head.", "gs_head.", RENDERER, "pts_head.", "norm_head.")
UNUSED = {
    r"visual_geometry_transformer\.patch_embed\.mask_token$": "the published network never reads it",
    r"visual_geometry_transformer\.(pose|ray)_embed\.": "read known cameras; used with that `known`",
    r"visual_geometry_transformer\.depth_embed\.": "reads known depth, which no embedder here is given",
    r"pts_head\.": "predicts points, which no Gaussian is placed by",
    r"norm_head\.": "predicts normals, which nothing here reads",
}
"""Published tensors without a place here, or with one by an option alone, by regular expression, and why."""

_RULES = (
    (r"^embedder\.patches\.proj\.", f"{TRUNK}patch_embed.patch_embed.proj."),
    (r"^embedder\.patches\.", f"{TRUNK}patch_embed."),
    (r"^embedder\.camera_token", f"{TRUNK}cam_token"),
    (r"^embedder\.register_token", f"{TRUNK}reg_token"),
    (r"^embedder\.pose\.", f"{TRUNK}pose_embed."),
    (r"^embedder\.lens\.", f"{TRUNK}ray_embed."),
    (r"^aggregator\.", TRUNK),
    (r"^geometry_head\.camera\.modulation\.", "cam_head.adapt_norm_gen.1."),
    (r"^geometry_head\.camera\.trunk\.", "cam_head.refine_net."),
    (r"^geometry_head\.camera\.trunk_norm\.", "cam_head.out_norm."),
    (r"^geometry_head\.camera\.empty_pose_tokens", "cam_head.init_token"),
    (r"^geometry_head\.camera\.embed_pose\.", "cam_head.param_embed."),
    (r"^geometry_head\.camera\.pose_branch\.", "cam_head.param_predictor."),
    (r"^geometry_head\.camera\.", "cam_head."),
    (r"^geometry_head\.depth\.", "depth_head."),
    (r"^geometry_head\.placing\.", "gs_head."),
    (r"^gaussian_head\.dpt\.output\.", RENDERER),
    (r"^gaussian_head\.dpt\.", "gs_head."),
    (r"^gaussian_head\.direct\.", "gs_head.input_merger.0."),
    *dpt_rules("depth_head|gs_head"),
)


def backbone_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of a :class:`~anystyle_backbones.worldmirror.WorldMirror`, its published name; two may share one."""
    return {key: renamed(key, _RULES) for key in keys}


class WorldMirrorCheckpoints(Published):
    """The file of WorldMirror, version 1."""

    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        options = options_of(_checked(state))
        return {f"backbone.{name}": value for name, value in options.items()} | {"branch.sh_degree": 0}

    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        _checked(state)
        return {"backbone": True}

    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load the file into a backbone of the same options."""
        if part != "backbone":
            raise UserError("the checkpoint holds no style branch; give one that anystyle trained, or null")
        names, unused = backbone_names(module.state_dict()), re.compile("|".join(UNUSED))
        read = set(names.values())
        given = {name: value for name, value in _checked(state).items() if name in read or not unused.match(name)}
        load_renamed(module, given, names, what="backbone", layout=LAYOUT)


def _checked(state: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
    checked_parts(state, PARTS, publisher=PUBLISHER, advice="give the file of tencent/HunyuanWorld-Mirror")
    return state


def options_of(state: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the backbone, as far as shapes tell: not the layers that heads read, nor heads of the camera head."""
    of = partial(length, state, publisher=PUBLISHER)
    dim, patch_size = (of(f"{TRUNK}patch_embed.patch_embed.proj.weight", axis) for axis in (0, 3))
    return {
        "patch_size": patch_size,
        "native_resolution": patch_size * math.isqrt(of(f"{TRUNK}patch_embed.pos_embed", 1) - 1),
        "dim": dim,
        "embed_depth": count(state, f"{TRUNK}patch_embed.blocks."),
        "depth": count(state, f"{TRUNK}frame_blocks."),
        "heads": dim // of(f"{TRUNK}frame_blocks.0.attn.q_norm.weight", 0),
        "camera_depth": count(state, "cam_head.refine_net."),
        "depth_hidden": of("depth_head.scratch.output_conv2.0.weight", 0),
        "gaussian_hidden": of(f"{RENDERER}0.weight", 0),
        **decoder_options(of, "depth_head", "depth"),
        **decoder_options(of, "gs_head", "gaussian"),
    }
