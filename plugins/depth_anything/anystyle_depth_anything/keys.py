"""The published checkpoints' names for our parameters, and strict loading by them.

The files of ``depth-anything/DA3-*`` on Hugging Face have keys ``model.…``; the nested ones hold two networks,
``model.da3.…`` and one for metric depth alone, which is dropped. Names here are without those prefixes. No style branch
is published for this network. This module is what :class:`anystyle.contracts.Published` asks for.
"""

import re
from collections.abc import Iterable, Mapping, Sequence

import torch
from torch import Tensor, nn

from anystyle.types import Site
from anystyle_depth_anything import shapes

PARTS = ("backbone.pretrained.", "head.", "cam_enc.", "cam_dec.", "gs_head.")
GAUSSIANS = "gs_head."
UNUSED = re.compile(r"^head\.scratch\.output_conv[12]_aux\.[0-2]\.")
"""What the published network holds and never shows: the second chain's outputs at coarser levels."""

_RENAMED = (
    (r"^embedder\.proj\.", "backbone.pretrained.patch_embed.proj."),
    (r"^embedder\.camera_encoder\.", "cam_enc."),
    (r"^(embedder|aggregator)\.", "backbone.pretrained."),
    (r"^geometry_head\.camera\.trunk\.", "cam_dec.backbone."),
    (r"^geometry_head\.camera\.translation\.", "cam_dec.fc_t."),
    (r"^geometry_head\.camera\.quaternion\.", "cam_dec.fc_qvec."),
    (r"^geometry_head\.camera\.field_of_view\.", "cam_dec.fc_fov.0."),
    (r"^geometry_head\.ray\.fusions\.", "head.ray_fusions."),
    (r"^geometry_head\.ray\.neck\.", "head.scratch.output_conv1_aux.3."),
    (r"^geometry_head\.ray\.first\.", "head.scratch.output_conv2_aux.3.0."),
    (r"^geometry_head\.ray\.norm\.", "head.scratch.output_conv2_aux.3.2."),
    (r"^geometry_head\.ray\.last\.", "head.scratch.output_conv2_aux.3.5."),
    (r"^geometry_head\.(depth\.)?", "head."),
    (r"^gaussian_head\.dpt\.", "gs_head."),
    (r"^gaussian_head\.direct\.", "gs_head.images_merger."),
    # Decoders; levels count from 0 here and from 1 there.
    (r"^(head|gs_head)\.resize\.", r"\1.resize_layers."),
    *((rf"^(head|gs_head)\.reduce\.{k}\.", rf"\1.scratch.layer{k + 1}_rn.") for k in range(4)),
    *((rf"^(head|gs_head)\.fusions\.{k}\.", rf"\1.scratch.refinenet{k + 1}.") for k in range(4)),
    *((rf"^head\.ray_fusions\.{k}\.", rf"head.scratch.refinenet{k + 1}_aux.") for k in range(4)),
    (r"(refinenet\d(?:_aux)?)\.level\.", r"\1.resConfUnit1."),
    (r"(refinenet\d(?:_aux)?)\.refine\.", r"\1.resConfUnit2."),
    (r"(refinenet\d(?:_aux)?)\.project\.", r"\1.out_conv."),
    (r"^(head|gs_head)\.neck\.", r"\1.scratch.output_conv1."),
    (r"^(head|gs_head)\.output\.", r"\1.scratch.output_conv2."),
)


def backbone_names(keys: Iterable[str]) -> dict[str, str]:
    """For each key of a :class:`~anystyle_depth_anything.DepthAnything`, its published name."""
    return {key: _published(key) for key in keys}


def _published(key: str) -> str:
    for pattern, replacement in _RENAMED:
        key = re.sub(pattern, replacement, key)
    return key


def without_prefix(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A published state dict with names as here, whichever file it comes from.

    Raises:
        ValueError: It is of another network.
    """
    bare = {key.removeprefix("model."): tensor for key, tensor in state.items()}
    if any(name.startswith("da3.") for name in bare):
        bare = {name.removeprefix("da3."): bare[name] for name in bare if not name.startswith("da3_metric.")}
    foreign = [name for name in bare if not name.startswith(PARTS)]
    if foreign or not bare:
        raise ValueError(
            f"the checkpoint has {len(foreign)} keys that are not Depth Anything 3's ({_some(foreign)}); give the file "
            "of one of depth-anything/DA3-SMALL, DA3-BASE, DA3-LARGE, DA3-GIANT or DA3NESTED-GIANT-LARGE"
        )
    if "backbone.pretrained.camera_token" not in bare:
        raise ValueError(
            "the checkpoint has no camera tokens: it is of a size that sees one view alone (metric, mono) and makes no "
            "scene; give the file of depth-anything/DA3-SMALL, DA3-BASE, DA3-LARGE or DA3-GIANT"
        )
    return bare


def complete(state: Mapping[str, Tensor]) -> bool:
    """Whether a state dict holds the whole network; most sizes are published without a Gaussian head."""
    return _has_gaussians(without_prefix(state))


def _has_gaussians(names: Iterable[str]) -> bool:
    return any(name.startswith(GAUSSIANS) for name in names)


def options(state: Mapping[str, Tensor]) -> dict[str, object]:
    """Options of the :class:`~anystyle_depth_anything.DepthAnything` whose weights these are, as far as shapes tell.

    Raises:
        ValueError: Tensors are missing that sizes are read off.
    """
    return shapes.options(without_prefix(state))


def placement(state: Mapping[str, Tensor]) -> str | None:
    """``None``: no checkpoint of this network holds a style branch."""
    without_prefix(state)
    return None


def injector_options(state: Mapping[str, Tensor], sites: Sequence[Site]) -> dict[str, dict[str, int]]:
    """Empty, for the same reason."""
    without_prefix(state)
    return {}


def text_adapter(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Empty, for the same reason."""
    without_prefix(state)
    return {}


def load_branch(branch: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Refuse: there is nothing to load.

    Raises:
        ValueError: Always.
    """
    without_prefix(state)
    raise ValueError("a checkpoint of Depth Anything 3 holds no style branch; give one that anystyle trained, or null")


def load_backbone(backbone: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Load a checkpoint into a backbone of the same options; without a Gaussian head in it, ours stays as it is.

    Raises:
        ValueError: Keys or shapes differ; up to five of each kind of difference are named.
    """
    own = backbone.state_dict()
    given = {name: tensor for name, tensor in without_prefix(state).items() if not UNUSED.match(name)}
    names = backbone_names(own)
    if not _has_gaussians(given):
        names = {key: name for key, name in names.items() if not name.startswith(GAUSSIANS)}
    _load(backbone, _matched(given, own, names))


def _matched(state: Mapping[str, Tensor], own: Mapping[str, Tensor], names: Mapping[str, str]) -> dict[str, Tensor]:
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
            f"the checkpoint does not fit this backbone: {'; '.join(differences)} (expected: {len(names)} tensors in "
            "the layout of Depth Anything 3; choose the preset of its size, such as backbone=depth_anything_base)"
        )
    return {key: state[name].reshape(own[key].shape).to(own[key].dtype) for key, name in names.items()}


def _squeezed(tensor: Tensor) -> Tensor:
    """A weight without the unit axes of a 1x1 convolution, which is a linear map here."""
    return tensor.flatten(1) if tensor.dim() > 2 and set(tensor.shape[2:]) == {1} else tensor


@torch.no_grad()
def _load(module: nn.Module, state: dict[str, Tensor]) -> None:
    own = module.state_dict()
    kept = {key: tensor for key, tensor in own.items() if key not in state}
    # A module on the meta device has no memory to copy into: it takes the tensors themselves.
    module.load_state_dict(state | kept, assign=any(tensor.is_meta for tensor in own.values()))


def _some(names: list[str]) -> str:
    return ", ".join(names[:5]) + (", …" if len(names) > 5 else "")
