"""The published checkpoints' names for our parameters, and strict loading by them.

The files of ``depth-anything/DA3-*`` on Hugging Face have keys ``model.…``; the nested ones hold two networks,
``model.da3.…`` and one only for metric depth, which is dropped. Names here are without those prefixes. No style branch
is published for this network.
"""

import re
from collections.abc import Iterable, Mapping
from functools import partial
from math import isqrt

from torch import Tensor, nn

from anystyle.contracts import Published
from anystyle.errors import UserError
from anystyle_backbones.published import (
    checked_parts,
    count,
    decoder_options,
    dpt_rules,
    length,
    load_renamed,
    numbers,
    renamed,
)

LAYOUT = "Depth Anything 3; choose the preset of its size, such as backbone=depth_anything_base"
PUBLISHER = "Depth Anything 3's"
GAUSSIANS = "gs_head."
PARTS = ("backbone.pretrained.", "head.", "cam_enc.", "cam_dec.", GAUSSIANS)
UNUSED = re.compile(r"^(cam_enc\.|head\.scratch\.(refinenet\d|output_conv\d)_aux\.)")
"""What the published network holds and encoding photographs never reads: an encoder of known cameras, rays."""

_RULES = (
    (r"^embedder\.proj\.", "backbone.pretrained.patch_embed.proj."),
    (r"^(embedder|aggregator)\.", "backbone.pretrained."),
    (r"^geometry_head\.camera\.trunk\.", "cam_dec.backbone."),
    (r"^geometry_head\.camera\.translation\.", "cam_dec.fc_t."),
    (r"^geometry_head\.camera\.quaternion\.", "cam_dec.fc_qvec."),
    (r"^geometry_head\.camera\.field_of_view\.", "cam_dec.fc_fov.0."),
    (r"^geometry_head\.(depth\.)?", "head."),
    (r"^gaussian_head\.dpt\.", GAUSSIANS),
    (r"^gaussian_head\.direct\.", "gs_head.images_merger."),
    *dpt_rules("head|gs_head"),
)


def backbone_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of a :class:`~anystyle_backbones.depth_anything.DepthAnything`, its published name."""
    return {key: renamed(key, _RULES) for key in keys}


class DepthAnythingCheckpoints(Published):
    """The files of Depth Anything 3 that see several views."""

    def names(self, keys: Iterable[str]) -> dict[str, str]:
        return backbone_names(keys)

    def without_prefix(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The tensors under their publishers' names, without the prefixes of their file."""
        bare = {key.removeprefix("model."): tensor for key, tensor in state.items()}
        if any(name.startswith("da3.") for name in bare):
            bare = {name.removeprefix("da3."): bare[name] for name in bare if not name.startswith("da3_metric.")}
        checked_parts(
            bare,
            PARTS,
            publisher=PUBLISHER,
            advice="give the file of one of depth-anything/DA3-SMALL, DA3-BASE, DA3-LARGE, DA3-GIANT or "
            "DA3NESTED-GIANT-LARGE",
        )
        if "backbone.pretrained.camera_token" not in bare:
            raise UserError(
                "the checkpoint has no camera tokens: it is of a size that sees one view alone (metric, mono) and "
                "makes no scene; give the file of depth-anything/DA3-SMALL, DA3-BASE, DA3-LARGE or DA3-GIANT"
            )
        return bare

    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        options = options_of(self.without_prefix(state))
        degree = {"branch.sh_degree": options.get("sh_degree", 0)}
        return {f"backbone.{name}": value for name, value in options.items()} | degree

    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        """Most sizes are published without a Gaussian head."""
        return {"backbone": any(name.startswith(GAUSSIANS) for name in self.without_prefix(state))}

    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load a checkpoint into a backbone of the same options; without a Gaussian head in it, ours stays as it is."""
        if part != "backbone":
            raise UserError("the checkpoint holds no style branch; give one that anystyle trained, or null")
        given = {name: tensor for name, tensor in self.without_prefix(state).items() if not UNUSED.match(name)}
        names = backbone_names(module.state_dict())
        if not any(name.startswith(GAUSSIANS) for name in given):
            names = {key: name for key, name in names.items() if not name.startswith(GAUSSIANS)}
        load_renamed(module, given, names, what="backbone", layout=LAYOUT)


TAPS = {12: (5, 7, 9, 11), 24: (11, 15, 19, 23), 40: (19, 27, 33, 39)}
"""The layers that heads read, by the published depth of the trunk: shapes do not tell them."""


def options_of(state: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the backbone, as far as shapes tell.

    Without a Gaussian head in it, they are of a network whose head is like the depth head and not yet trained.
    """
    of, trunk = partial(length, state, publisher=PUBLISHER), "backbone.pretrained."
    dim, patch_size = (of(f"{trunk}patch_embed.proj.weight", axis) for axis in (0, 3))
    start = min(numbers(state, rf"{re.escape(trunk)}blocks\.(\d+)\.attn\.q_norm\."), default=0)
    depth = count(state, f"{trunk}blocks.")
    gated = f"{trunk}blocks.0.mlp.w12.weight" in state
    options: dict[str, object] = {
        "patch_size": patch_size,
        "native_resolution": patch_size * isqrt(of(f"{trunk}pos_embed", 1) - 1),
        "dim": dim,
        "depth": depth,
        "heads": dim // of(f"{trunk}blocks.{start}.attn.q_norm.weight", 0),
        "ffn": "swiglu" if gated else "mlp",
        "alternate_from": start,
        **decoder_options(of, "head", "depth"),
    }
    if not gated:
        options["mlp_ratio"] = of(f"{trunk}blocks.0.mlp.fc1.weight", 0) / dim
    if depth in TAPS:
        options["taps"] = TAPS[depth]
    outputs = "gs_head.scratch.output_conv2.2.weight"
    if outputs not in state:
        untrained = {"depth_along": "z", "rotations": "camera", "init": "scratch"}
        return options | decoder_options(of, "head", "gaussian") | untrained
    options["sh_degree"] = isqrt((of(outputs, 0) - 11) // 3) - 1
    return options | decoder_options(of, "gs_head", "gaussian")
