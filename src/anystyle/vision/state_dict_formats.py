"""Published files of weights by the names of their tensors: recognising a kind, and checking a file."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from anystyle.errors import UserError
from anystyle.vision import art_score, inception, networks, raft, weights
from anystyle.vision.clip import Clip, load_clip

State = Mapping[str, Tensor]


def without_module(state: State) -> dict[str, Tensor]:
    """Tensors without the prefix that parallel training leaves in their names."""
    return {key.removeprefix("module."): tensor for key, tensor in state.items()}


class Layout(NamedTuple):
    """The names of tensors in one kind of file, recognised by a tensor's name and shape, 0 for any length."""

    about: str
    probe: str
    shape: tuple[int, ...]
    check: Callable[[Path], object]  # raises a UserError if a file is not whole
    names: Callable[[State], dict[str, Tensor]] = dict  # renames tensors for `anystyle weights convert`


def layout_of(state: State) -> str | None:
    """The key of :data:`LAYOUTS` that a state dict's tensors follow; ``None`` if none."""
    shapes = {key: tuple(tensor.shape) for key, tensor in without_module(state).items()}
    for name, layout in LAYOUTS.items():
        shape = shapes.get(layout.probe, ())
        masked = tuple(length * bool(expected) for expected, length in zip(layout.shape, shape, strict=False))
        if len(shape) == len(layout.shape) and masked == layout.shape:
            return name
    return None


def _check_heads(path: Path) -> None:
    if (count := len(weights.read(path))) != 5:
        raise UserError(f"{path} has {count} tensors; LPIPS' linear heads are 5 (lin0 to lin4)")


def _check_clip(path: Path) -> None:
    given = without_module(weights.read(path))
    blocks = [key for key in given if key.endswith(".ln_1.weight")]
    try:
        vocabulary, width = given["token_embedding.weight"].shape
        image_width, _, patch_size = given["visual.conv1.weight"].shape[:3]
        with torch.device("meta"):
            network = Clip(
                context=len(given["positional_embedding"]),
                vocabulary=vocabulary,
                text_width=width,
                text_layers=sum(key.startswith("transformer.") for key in blocks),
                image_width=image_width,
                image_layers=sum(key.startswith("visual.") for key in blocks),
                patch_size=patch_size,
                resolution=round((len(given["visual.positional_embedding"]) - 1) ** 0.5) * patch_size,
                dim=given["text_projection"].shape[1],
            )
        load_clip(network, given)
    except (KeyError, ValueError) as error:
        reason = f"1 missing ({error.args[0]})" if isinstance(error, KeyError) else error
        raise UserError(f"{path}: {reason}") from None


_HEADS, _INCEPTION, _VGG = "lin4.model.1.weight", "Mixed_7c.branch_pool.conv.weight", (512, 512, 3, 3)
LAYOUTS: dict[str, Layout] = {
    "clip": Layout("CLIP or Long-CLIP, in OpenAI's names", "visual.proj", (0, 0), _check_clip, without_module),
    "vgg19": Layout("VGG-19 in torchvision's names", "features.34.weight", _VGG, partial(networks.load, "vgg19")),
    "vgg16": Layout("VGG-16 in torchvision's names", "features.28.weight", _VGG, partial(networks.load, "vgg16")),
    "alexnet": Layout(
        "AlexNet in torchvision's names", "features.0.weight", (64, 3, 11, 11), partial(networks.load, "alexnet")
    ),
    "lpips_alex": Layout("LPIPS' linear heads over AlexNet", _HEADS, (1, 256, 1, 1), _check_heads),
    "lpips_vgg": Layout("LPIPS' linear heads over VGG-16", _HEADS, (1, 512, 1, 1), _check_heads),
    "art_inception": Layout(
        "Inception-v3 with two classifiers, trained on paintings", _INCEPTION, (192, 2048, 1, 1), inception.load
    ),
    "art_score": Layout(
        "ResNet-50 with ArtScore's head in torchvision's names", "fc.3.weight", (1, 1000), art_score.load
    ),
    "raft": Layout(
        "RAFT in its authors' names",
        "fnet.conv1.weight",
        (64, 3, 7, 7),
        partial(raft.load, "raft_things"),
        without_module,
    ),
    "raft_torchvision": Layout(
        "RAFT in torchvision's names",
        "feature_encoder.convnormrelu.0.weight",
        (64, 3, 7, 7),
        partial(raft.load, "raft_large"),
    ),
}
"""Every kind of file by name, except for those of backbones, which their plugins know."""
