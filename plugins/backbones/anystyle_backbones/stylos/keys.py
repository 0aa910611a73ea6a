"""What Stylos' checkpoints call our parameters, what their shapes tell, and strict loading."""

import logging
import re
from collections.abc import Iterable, Mapping

from torch import Tensor, nn

from anystyle.contracts import Published
from anystyle.errors import UserError
from anystyle_backbones.anysplat import keys as anysplat
from anystyle_backbones.anysplat.networks import DinoV2
from anystyle_backbones.published import checked_parts, count, dpt_rules, first_names, load_renamed, renamed

_log = logging.getLogger(__name__)

LAYOUT, PUBLISHER = "Stylos", "Stylos'"
STYLE, STYLE_HEAD = "style_aggregator.", "style_gaussian_param_head."
PARTS = (*anysplat.BACKBONE_PARTS, STYLE, STYLE_HEAD)
PATCHES = "aggregator.patch_embed."
SECOND = ((rf"^{STYLE}aggregator\.", "aggregator."), (rf"^{STYLE}patch_embed\.", PATCHES))
"""From second names of tensors, which the style aggregator has of the aggregator's, to the first."""
DROPPED = re.compile(r"(losses\.\d+\.(net\.enc_\d|clip_model)|distill_(aggregator|camera_head|depth_head))\.")
"""What training keeps beside the network: AdaIN's VGG, CLIP, and the teacher."""

_RULES = (
    (r"^gaussian_head\.direct\.", "gaussian_param_head.input_merger."),
    (r"^gaussian_head\.style_aggregator\.layers\.(\d+)\.(global|frame)\.", rf"{STYLE}\2_blocks.\1."),
    (r"^gaussian_head\.style_aggregator\.", STYLE),
    (r"^gaussian_head\.style_head\.", STYLE_HEAD),
    *dpt_rules("style_gaussian_param_head"),
)


def backbone_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of a :class:`~anystyle_backbones.stylos.Stylos`, its published name."""
    own = {key: renamed(key, _RULES) for key in keys}
    shared = anysplat.backbone_names(own.values())
    return {key: shared[name] for key, name in own.items()}


def branch_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of the published style branch, its published name."""
    inside = {key: re.sub(r"^(gaussian_)?(aggregator|head)\.", r"gaussian_head.style_\2.", key) for key in keys}
    names = backbone_names(inside.values())
    return {key: names[name] for key, name in inside.items()}


class StylosCheckpoints(Published):
    """Files of ``from_pretrained`` (``encoder.…``), and Lightning checkpoints (``model.encoder.…``)."""

    def names(self, keys: Iterable[str]) -> dict[str, str]:
        return backbone_names(keys)

    def without_prefix(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The network's tensors under their first names, without the prefixes of their file.

        Its style aggregator names the tensors of the aggregator a second time; these are the same, or stand for them.
        """
        bare = {re.sub(r"^(model\.)?encoder\.", "", key): tensor for key, tensor in state.items()}
        bare = {name: tensor for name, tensor in bare.items() if not DROPPED.match(name)}
        advice = "give a file of the datasets HanzhouLiu/Stylos or HanzhouLiu/Stylos_Weights on Hugging Face"
        checked_parts(bare, PARTS, publisher=PUBLISHER, advice=advice)
        if any(name.startswith((f"{STYLE_HEAD}shallow_extractor.", f"{STYLE_HEAD}cross_attn.")) for name in bare):
            raise UserError("the checkpoint's style head is of the type crossattn, which no configuration names")
        return first_names(bare, SECOND)

    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        options = options_of(self.without_prefix(state))
        encoder = {name: options[name] for name in ("native_resolution", "dim", "heads")}
        encoder["depth"] = options["embed_depth"]
        config = {f"backbone.{name}": value for name, value in options.items()}
        config |= {"style_encoder": "stylos", "branch.published": True}
        return config | {f"style_encoder.{name}": value for name, value in encoder.items()}

    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        """Every file is a whole model."""
        self.without_prefix(state)
        return {"backbone": True, "branch": True, "style_encoder": True}

    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load a part; a style encoder of another kind stays as it is."""
        given, keys = self.without_prefix(state), module.state_dict()
        if part == "backbone":
            names, prefixes = backbone_names(keys), PARTS
        elif part == "branch":
            names, prefixes = branch_names(keys), (STYLE, STYLE_HEAD)
        elif isinstance(module._modules.get("patches"), DinoV2):
            names, prefixes = backbone_names(f"embedder.{key}" for key in keys), (PATCHES,)
            names = {key.removeprefix("embedder."): name for key, name in names.items()}
        else:
            return
        given = {name: given[name] for name in given if name.startswith(prefixes) and name not in anysplat.UNUSED}
        load_renamed(module, given, names, what=part.replace("_", " "), layout=LAYOUT)


PUBLISHED_TAPS, PUBLISHED_DEPTH, VOXEL_SIZE = (2, 5, 8, 11), 12, 0.002
SHARED = ("native_resolution", "dim", "embed_depth", "depth", "heads", "taps", "camera_depth")
DECODERS = ("depth_features", "depth_channels", "gaussian_features", "gaussian_channels")


def options_of(names: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the :class:`~anystyle_backbones.stylos.Stylos` that a checkpoint fits.

    Which layers heads read, and the size of voxels, cannot be seen: they are the published ones, or layers at the
    same fraction of the depth, and the log says so.
    """
    options = anysplat.options_of(names)
    depths = {kind: count(names, f"{STYLE}{kind}_blocks.") for kind in ("global", "frame")}
    kinds, depth = [kind for kind in depths if depths[kind]], max(depths.values())
    if not kinds:
        raise UserError(f"the checkpoint has no {STYLE}global_blocks; it is not {PUBLISHER}, or not all of it")
    taps = tuple(layer * (depth - 1) // (PUBLISHED_DEPTH - 1) for layer in PUBLISHED_TAPS)
    _log.info(
        "not in the checkpoint, and assumed: backbone.style_taps=%s backbone.voxel_size=%s", list(taps), VOXEL_SIZE
    )
    return {
        **{name: options[name] for name in (*SHARED, *DECODERS) if name in options},
        "style_depth": depth,
        "style_order": "hybrid" if len(kinds) > 1 else kinds[0],
        "style_taps": taps,
        "image_features": "gaussian_param_head.input_merger.0.weight" in names,
        "voxel_size": VOXEL_SIZE,
    }
