"""Published files of weights by the names of their tensors: telling a file's kind, and checking that it is whole."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from anystyle import perception
from anystyle.perception import art_score, inception, raft
from anystyle.perception.clip import Clip, load_clip

State = Mapping[str, Tensor]


@dataclass(frozen=True)
class Layout:
    """The names of tensors in one kind of file.

    Args:
        about: What such a file is.
        probes: Some of its tensors with their shapes, 0 for any length; a file that has them is of this kind.
        check: Called with the file and its tensors; raises a ValueError of one line where the file is not whole.
        names: The same tensors under the names that they are kept under, without what training left behind.
    """

    about: str
    probes: Mapping[str, tuple[int, ...]]
    check: Callable[[Path, State], object]
    names: Callable[[State], dict[str, Tensor]] = dict

    def fits(self, state: State) -> bool:
        """Whether a state dict has this layout's probes."""
        bare = _bare(state)
        return all(key in bare and _fits(tuple(bare[key].shape), shape) for key, shape in self.probes.items())


def layout_of(state: State) -> str | None:
    """The key of :data:`LAYOUTS` that a state dict's tensors follow; ``None`` if none."""
    return next((name for name, layout in LAYOUTS.items() if layout.fits(state)), None)


def _fits(shape: tuple[int, ...], probe: tuple[int, ...]) -> bool:
    return len(shape) == len(probe) and all(length in (size, 0) for size, length in zip(shape, probe, strict=True))


def _bare(state: State) -> dict[str, Tensor]:
    return {key.removeprefix("module."): tensor for key, tensor in state.items()}


def _heads(channels: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    return {f"lin{index}.model.1.weight": (1, width, 1, 1) for index, width in enumerate(channels)}


def _check_heads(path: Path, state: State) -> None:
    if len(state) != 5:
        raise ValueError(f"{path} has {len(state)} tensors; LPIPS' linear heads are 5 (lin0 to lin4)")


def _check_clip(path: Path, state: State) -> None:
    bare = _bare(state)
    vocabulary, width = bare["token_embedding.weight"].shape
    image_width, _, patch_size = bare["visual.conv1.weight"].shape[:3]

    def num_layers(tower: str) -> int:
        return sum(key.startswith(tower) and key.endswith(".ln_1.weight") for key in bare)

    with torch.device("meta"):
        network = Clip(
            context=len(bare["positional_embedding"]),
            vocabulary=vocabulary,
            text_width=width,
            text_layers=num_layers("transformer."),
            image_width=image_width,
            image_layers=num_layers("visual.transformer."),
            patch_size=patch_size,
            resolution=round((len(bare["visual.positional_embedding"]) - 1) ** 0.5) * patch_size,
            dim=bare["text_projection"].shape[1],
        )
    try:
        load_clip(network, bare)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


LAYOUTS: dict[str, Layout] = {
    "clip": Layout(
        "CLIP or Long-CLIP with a vision transformer, in OpenAI's names",
        {"visual.proj": (0, 0), "visual.conv1.weight": (0, 3, 0, 0), "text_projection": (0, 0)}
        | {"token_embedding.weight": (0, 0), "positional_embedding": (0, 0), "visual.positional_embedding": (0, 0)},
        _check_clip,
        _bare,
    ),
    "vgg19": Layout(
        "VGG-19 in torchvision's names",
        {"features.34.weight": (512, 512, 3, 3)},
        lambda path, _: perception.load("vgg19", path),
    ),
    "vgg16": Layout(
        "VGG-16 in torchvision's names",
        {"features.28.weight": (512, 512, 3, 3)},
        lambda path, _: perception.load("vgg16", path),
    ),
    "alexnet": Layout(
        "AlexNet in torchvision's names",
        {"features.0.weight": (64, 3, 11, 11)},
        lambda path, _: perception.load("alexnet", path),
    ),
    "lpips_alex": Layout("LPIPS' linear heads over AlexNet", _heads((64, 192, 384, 256, 256)), _check_heads),
    "lpips_vgg": Layout("LPIPS' linear heads over VGG-16", _heads((64, 128, 256, 512, 512)), _check_heads),
    "art_inception": Layout(
        "Inception-v3 with two classifiers, trained on paintings",
        {"Mixed_7c.branch_pool.conv.weight": (192, 2048, 1, 1)},
        lambda path, _: inception.load(path),
    ),
    "art_score": Layout(
        "ResNet-50 with ArtScore's head in torchvision's names",
        {"layer4.2.conv3.weight": (2048, 512, 1, 1), "fc.3.weight": (1, 1000)},
        lambda path, _: art_score.load(path),
    ),
    "raft": Layout(
        "RAFT in its authors' names", {"fnet.conv1.weight": (64, 3, 7, 7)}, lambda path, _: raft.load(path=path), _bare
    ),
    "raft_torchvision": Layout(
        "RAFT in torchvision's names",
        {"feature_encoder.convnormrelu.0.weight": (64, 3, 7, 7)},
        lambda path, _: raft.load(path=path),
    ),
}
"""Every kind of file by name, except for those of backbones, which their plugins know."""
