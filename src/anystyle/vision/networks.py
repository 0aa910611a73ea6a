"""Frozen networks, loaded by name for losses and metrics."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from torch import Tensor, nn

from anystyle.errors import UserError
from anystyle.types import Source
from anystyle.vision import weights
from anystyle.vision.efficientnet import EfficientNetLite0
from anystyle.vision.features import FeatureNetwork, load_frozen
from anystyle.vision.vgg import VGG16, VGG19, AdainVGG, AlexNet, Texture
from anystyle.vision.weights import published

NETWORKS: dict[str, type[FeatureNetwork]] = {
    "vgg19": VGG19,
    "vgg16": VGG16,
    "alexnet": AlexNet,
    "efficientnet_lite0": EfficientNetLite0,
    "texture": Texture,
    "vgg_normalised": AdainVGG,
}
"""By name, which is also that of their weights in :mod:`anystyle.vision.weights`."""


def load(name: str, path: str | Path | None = None) -> FeatureNetwork:
    """A trained network of :data:`NETWORKS`, frozen, from a file or from where :func:`weights.find` looks."""
    if name not in NETWORKS:
        raise UserError(f"there is no perceptual network {name!r}; choose from {', '.join(NETWORKS)}")
    file, network = weights.find(name, path), NETWORKS[name]()
    return load_frozen(network, part_of(network, weights.read(file)), file)


def part_of(network: nn.Module, state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The weights without those of parts that a network leaves out, such as the classifier in published files."""
    parts = {key.partition(".")[0] for key in network.state_dict()}
    return {key: tensor for key, tensor in state.items() if key.partition(".")[0] in parts}


class Chosen(NamedTuple):
    """A network that was chosen from several, with its name and the name of the ``preferred`` one."""

    network: FeatureNetwork
    layers: tuple[str, ...]
    name: str
    preferred: str

    @property
    def source(self) -> Source:
        """The weights that it loaded."""
        source = published(self.name, weights.find(self.name))
        return source if self.name == self.preferred else replace(source, network=self.preferred, stand_in=self.name)


def choose(names: str, layers: Sequence[str]) -> Chosen:
    """The first of some networks, such as ``vgg16,texture``, whose weights are found.

    A layer that a network after the first lacks is replaced by its last of the same block, or of all.
    """
    first, *others = (name.strip() for name in names.split(","))
    known = (n for n in (first, *others) if n not in NETWORKS or any(p.is_file() for p in weights.candidates(n)))
    network = load(name := next(known, first))
    if name != first:
        own = network.layers
        blocks = [[one for one in own if one.partition("_")[0] == layer.partition("_")[0]] for layer in layers]
        layers = [layer if layer in own else (block or own)[-1] for layer, block in zip(layers, blocks, strict=True)]
    return Chosen(network, tuple(dict.fromkeys(layers)), name, first)
