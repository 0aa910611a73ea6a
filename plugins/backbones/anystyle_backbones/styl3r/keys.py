"""The published checkpoints' names for our parameters, and strict loading by them.

The files are Lightning checkpoints with keys ``encoder.…``, all of one layout; names here are without that prefix. One
file holds the backbone, the style branch and the style encoder. Nothing in it tells a network that was trained on
styles from one that was trained on photographs alone.
"""

import re
from collections.abc import Iterable, Mapping
from functools import partial
from math import isqrt

from torch import Tensor, nn

from anystyle.contracts import Published
from anystyle.errors import UserError
from anystyle_backbones.published import checked_parts, count, first_names, fusion_rules, length, load_renamed, renamed

LAYOUT = "Styl3R; choose model=styl3r"
PUBLISHER = "Styl3R's"
HEADS = ("downstream_head1.", "downstream_head2.", "gaussian_param_head.", "gaussian_param_head2.")
PARTS = ("backbone.", "token_stylizer.", "gaussian_appearance_head.", *HEADS)
OTHERS = ("structure_builder.", "gaussian_structure_head.")
"""Parts of another network of the same repository, which its own code does not run."""
MARKS = ("token_stylizer.dec_blocks.0.cross_attn.projq.weight", "backbone.dec_blocks2.0.cross_attn.projq.weight")
"""Tensors that no other network has."""
SECOND = tuple((rf"\.scratch\.layer_rn\.{level}\.", f".scratch.layer{level + 1}_rn.") for level in range(4))
"""From second names of tensors to the first."""
UNUSED = re.compile(r"\.mask_token$|\.refinenet4\.resConfUnit1\.")
"""What the published network holds and never reads."""

_RULES = (
    (r"^gaussian_head\.style_encoder\.", "token_stylizer."),
    (r"^embedder\.encoder\.", "backbone."),
    (r"^embedder\.intrinsics\.", "backbone.intrinsic_encoder."),
    (r"^aggregator\.first\.", "backbone.dec_blocks."),
    (r"^aggregator\.others\.", "backbone.dec_blocks2."),
    (r"^aggregator\.", "backbone.decoder."),
    (r"^gaussian_head\.stylizer\.", "token_stylizer.decoder."),
    (r"\.decoder\.embed\.", ".decoder_embed."),
    (r"\.decoder\.(blocks|norm)\.", r".dec_\1."),
    (r"^(backbone|token_stylizer)\.patches\.", r"\1.patch_embed.proj."),
    (r"^(backbone|token_stylizer)\.(blocks|norm)\.", r"\1.enc_\2."),
    (r"^geometry_head\.first\.", "downstream_head1.dpt."),
    (r"^geometry_head\.others\.", "downstream_head2.dpt."),
    (r"^gaussian_head\.first\.", "gaussian_param_head.dpt."),
    (r"^gaussian_head\.others\.", "gaussian_param_head2.dpt."),
    (r"^gaussian_head\.color\.dpt\.", "gaussian_appearance_head.dpt."),
    (r"\.dpt\.projects\.(\d)\.", r".dpt.act_postprocess.\1.0."),
    (r"\.dpt\.resize\.(\d)\.", r".dpt.act_postprocess.\1.1."),
    *((rf"\.dpt\.reduce\.{level}\.", f".dpt.scratch.layer{level + 1}_rn.") for level in range(4)),
    *fusion_rules(r".*\.dpt"),
    (r"\.dpt\.neck\.", ".dpt.head.0."),
    (r"^(downstream_head\d\.dpt)\.output\.0\.", r"\1.head.2."),
    (r"\.dpt\.output\.2\.", ".dpt.head.4."),
    (r"\.dpt\.output\.0\.", ".dpt.head.0."),
    (r"\.dpt\.direct\.", ".dpt.input_merger.0."),
)
_BRANCH = ((r"^aggregator\.", "gaussian_head.stylizer."), (r"^gaussian_head\.dpt\.", "gaussian_head.color.dpt."))
"""From names of the style branch to those of what it copies."""
_STYLE_ENCODER = ((r"^encoder\.", "gaussian_head.style_encoder."),)
_OWN = {"backbone": (), "branch": _BRANCH, "style_encoder": _STYLE_ENCODER}


def published_names(keys: Iterable[str], part: str = "backbone") -> dict[str, str]:
    """For each key of a part, its published name."""
    return {key: renamed(renamed(key, _OWN[part]), _RULES) for key in keys}


class Styl3rCheckpoints(Published):
    """The files of WU-CVGL/Styl3R on Hugging Face."""

    def names(self, keys: Iterable[str]) -> dict[str, str]:
        return published_names(keys)

    def without_prefix(self, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The tensors under their publishers' names, without the prefix of their file."""
        bare = {key.removeprefix("encoder."): tensor for key, tensor in state.items()}
        advice = "give the file of re10k_2v, re10k_4v or re10k_dl3dv_4v"
        if any(name.startswith(OTHERS) for name in bare):
            raise UserError(
                "the checkpoint has a structure builder: it is of another network of Styl3R's repository, which that "
                f"does not run; {advice}"
            )
        checked_parts(bare, PARTS, publisher=PUBLISHER, advice=advice)
        if missing := [name for name in MARKS if name not in bare]:
            raise UserError(f"the checkpoint has no {missing[0]}: it is not {PUBLISHER}; {advice}")
        return first_names(bare, SECOND)

    def config(self, state: Mapping[str, Tensor]) -> dict[str, object]:
        options = options_of(self.without_prefix(state))
        encoder = {name: options[name] for name in ("patch_size", "dim", "depth", "heads", "mlp_ratio")}
        return (
            {"style_encoder": "styl3r", "branch.published": True}
            | {f"backbone.{name}": value for name, value in options.items()}
            | {f"style_encoder.{name}": value for name, value in encoder.items()}
        )

    def parts(self, state: Mapping[str, Tensor]) -> dict[str, bool]:
        self.without_prefix(state)
        return {"backbone": True, "style_encoder": True, "branch": True}

    def load(self, part: str, module: nn.Module, state: Mapping[str, Tensor]) -> None:
        """Load a part; all three are in one file, and those on the meta device share its tensors."""
        given = {name: tensor for name, tensor in self.without_prefix(state).items() if not UNUSED.search(name)}
        own = module.state_dict()
        names = published_names(own, part)
        if all(name in given and own[key].data_ptr() == given[name].data_ptr() for key, name in names.items()):
            return  # a part may be named twice, and copying would end the sharing
        # A part takes what is its own; what no part takes is found when the backbone, which has them all, is loaded.
        given = given if part == "backbone" else {name: given[name] for name in names.values() if name in given}
        load_renamed(module, given, names, what=part.replace("_", " "), layout=LAYOUT)


def options_of(state: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the backbone, as far as shapes tell; a head has 64 channels, as published."""
    of = partial(length, state, publisher=PUBLISHER)
    dim, patch_size = (of("backbone.patch_embed.proj.weight", axis) for axis in (0, 3))
    width, head = of("backbone.decoder_embed.weight", 0), "downstream_head1.dpt."
    return {
        "patch_size": patch_size,
        "dim": dim,
        "depth": count(state, "backbone.enc_blocks."),
        "heads": max(1, dim // 64),
        "decoder_dim": width,
        "decoder_depth": count(state, "backbone.dec_blocks."),
        "decoder_heads": max(1, width // 64),
        "mlp_ratio": of("backbone.enc_blocks.0.mlp.fc1.weight", 0) / dim,
        "features": of(f"{head}scratch.layer1_rn.weight", 0),
        "channels": tuple(of(f"{head}act_postprocess.{level}.0.weight", 0) for level in range(4)),
        "hidden": of(f"{head}head.2.weight", 0),
        "sh_degree": isqrt(of("gaussian_appearance_head.dpt.head.4.weight", 0) // 3) - 1,
    }
