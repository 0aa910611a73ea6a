"""What published files of weights call their tensors: telling a file's kind from its keys, and judging it strictly."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

State = Mapping[str, Tensor]


@dataclass(frozen=True)
class Layout:
    """How the tensors of one kind of file are called.

    Args:
        about: What such a file is.
        probes: Some of its tensors with their shapes, 0 for any length; a file that has them is of this kind.
        check: Raises a ValueError of one line where a file of this kind is not whole.
        names: The same tensors under the names that they are kept under, without what training left behind.
    """

    about: str
    probes: Mapping[str, tuple[int, ...]]
    check: Callable[[Path, State], None]
    names: Callable[[State], dict[str, Tensor]] = dict

    def fits(self, state: State) -> bool:
        """Whether a state dict has this layout's probes."""
        bare = {key.removeprefix("module."): tensor for key, tensor in state.items()}
        return all(key in bare and _alike(tuple(bare[key].shape), shape) for key, shape in self.probes.items())


def _alike(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return len(shape) == len(wanted) and all(length in (have, 0) for have, length in zip(shape, wanted, strict=True))


def layout_of(state: State) -> str | None:
    """The key of :data:`LAYOUTS` that a state dict's tensors follow; ``None`` if none."""
    return next((name for name, layout in LAYOUTS.items() if layout.fits(state)), None)


def _features(name: str) -> Callable[[Path, State], None]:
    def check(path: Path, _: State) -> None:
        from anystyle import perception

        perception.load(name, path)

    return check


def _heads(channels: tuple[int, ...]) -> dict[str, tuple[int, ...]]:
    return {f"lin{place}.model.1.weight": (1, width, 1, 1) for place, width in enumerate(channels)}


def _check_heads(path: Path, state: State) -> None:
    if len(state) != 5:
        raise ValueError(f"{path} has {len(state)} tensors; LPIPS' linear heads are 5 (lin0 to lin4)")


def _check_clip(path: Path, state: State) -> None:
    from anystyle.perception.clip import Clip, load_clip

    bare = _bare(state)
    vocabulary, width = bare["token_embedding.weight"].shape
    image_width, _, patch_size = bare["visual.conv1.weight"].shape[:3]
    count = {tower: sum(key.startswith(tower) and key.endswith(".ln_1.weight") for key in bare) for tower in _TOWERS}
    with torch.device("meta"):
        network = Clip(
            context=len(bare["positional_embedding"]),
            vocabulary=vocabulary,
            text_width=width,
            text_layers=count[_TOWERS[0]],
            image_width=image_width,
            image_layers=count[_TOWERS[1]],
            patch_size=patch_size,
            resolution=round((len(bare["visual.positional_embedding"]) - 1) ** 0.5) * patch_size,
            dim=bare["text_projection"].shape[1],
        )
    try:
        load_clip(network, bare)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


_TOWERS = ("transformer.", "visual.transformer.")


def _check_inception(path: Path, _: State) -> None:
    from anystyle.perception import inception

    inception.load(path)


def _check_art_score(path: Path, _: State) -> None:
    from anystyle.perception import art_score

    art_score.load(path)


def _check_raft(path: Path, _: State) -> None:
    from anystyle.perception import raft

    raft.load(path=path)


def _bare(state: State) -> dict[str, Tensor]:
    return {key.removeprefix("module."): tensor for key, tensor in state.items()}


LAYOUTS: dict[str, Layout] = {
    "clip": Layout(
        "CLIP or Long-CLIP with a vision transformer, in OpenAI's names",
        {"visual.proj": (0, 0), "visual.conv1.weight": (0, 3, 0, 0), "text_projection": (0, 0)}
        | {"token_embedding.weight": (0, 0), "positional_embedding": (0, 0), "visual.positional_embedding": (0, 0)},
        _check_clip,
        _bare,
    ),
    "vgg19": Layout("VGG-19 in torchvision's names", {"features.34.weight": (512, 512, 3, 3)}, _features("vgg19")),
    "vgg16": Layout("VGG-16 in torchvision's names", {"features.28.weight": (512, 512, 3, 3)}, _features("vgg16")),
    "alexnet": Layout("AlexNet in torchvision's names", {"features.0.weight": (64, 3, 11, 11)}, _features("alexnet")),
    "lpips_alex": Layout("LPIPS' linear heads over AlexNet", _heads((64, 192, 384, 256, 256)), _check_heads),
    "lpips_vgg": Layout("LPIPS' linear heads over VGG-16", _heads((64, 128, 256, 512, 512)), _check_heads),
    "art_inception": Layout(
        "Inception-v3 with two classifiers, trained on paintings",
        {"Mixed_7c.branch_pool.conv.weight": (192, 2048, 1, 1)},
        _check_inception,
    ),
    "art_score": Layout(
        "ResNet-50 with ArtScore's head in torchvision's names",
        {"layer4.2.conv3.weight": (2048, 512, 1, 1), "fc.3.weight": (1, 1000)},
        _check_art_score,
    ),
    "raft": Layout("RAFT in its authors' names", {"fnet.conv1.weight": (64, 3, 7, 7)}, _check_raft, _bare),
    "raft_torchvision": Layout(
        "RAFT in torchvision's names",
        {"feature_encoder.convnormrelu.0.weight": (64, 3, 7, 7)},
        _check_raft,
    ),
}
"""Every kind of file by name, those of backbones apart: their plugins know them."""
