"""Frozen networks, loaded by name for losses and metrics."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from anystyle.perception import weights
from anystyle.perception.efficientnet import EfficientNetLite0
from anystyle.perception.features import FeatureNetwork, load_frozen
from anystyle.perception.sources import Source, published
from anystyle.perception.texture import Texture
from anystyle.perception.vgg import VGG16, VGG19, AlexNet

NETWORKS: dict[str, type[FeatureNetwork]] = {
    "vgg19": VGG19,
    "vgg16": VGG16,
    "alexnet": AlexNet,
    "efficientnet_lite0": EfficientNetLite0,
    "texture": Texture,
}
"""By name, which is also that of their weights in :mod:`anystyle.perception.weights`."""


def load(name: str, path: str | Path | None = None) -> FeatureNetwork:
    """A trained network, frozen.

    Args:
        name: Of :data:`NETWORKS`.
        path: The file of its weights; ``None`` searches for it, see :func:`anystyle.perception.weights.find`.

    Raises:
        ValueError: There is no such network, or the file does not hold its weights.
        FileNotFoundError: Its weights are missing.
    """
    if name not in NETWORKS:
        raise ValueError(f"there is no perceptual network {name!r}; choose from {', '.join(NETWORKS)}")
    file = weights.find(name, path)
    network = NETWORKS[name]()
    # Published files hold the classifier too, which networks without logits leave out.
    parts = {key.partition(".")[0] for key in network.state_dict()}
    state = {key: tensor for key, tensor in weights.read(file).items() if key.partition(".")[0] in parts}
    return load_frozen(network, state, file)


class Chosen(NamedTuple):
    """A network that was chosen from several.

    Args:
        network: Frozen.
        layers: Those asked for, as far as it has them.
        name: Its own.
        preferred: The first choice, which it stands in for where it is another.
    """

    network: FeatureNetwork
    layers: tuple[str, ...]
    name: str
    preferred: str

    @property
    def source(self) -> Source:
        """The weights it rests on."""
        source = published(self.name, weights.find(self.name))
        return source if self.name == self.preferred else replace(source, network=self.preferred, stand_in=self.name)


def choose(names: str, layers: Sequence[str]) -> Chosen:
    """The first network whose weights are there.

    Args:
        names: Of networks with the same names of layers, such as ``vgg16,texture``.
        layers: Whose features are read. One that a network after the first lacks is its last of the same block, or of
            all.

    Raises:
        ValueError: A network is unknown.
        FileNotFoundError: The weights of none are there.
    """
    candidates = [name.strip() for name in names.split(",")]
    name = next((name for name in candidates if name not in NETWORKS or _is_there(name)), candidates[0])
    network = load(name)
    if name != candidates[0]:
        layers = [layer if layer in network.layers else _nearest_layer(layer, network.layers) for layer in layers]
    return Chosen(network, tuple(dict.fromkeys(layers)), name, candidates[0])


def _is_there(name: str) -> bool:
    return any(path.is_file() for path in weights.candidates(name))


def _nearest_layer(layer: str, offered: Sequence[str]) -> str:
    block = [known for known in offered if known.partition("_")[0] == layer.partition("_")[0]]
    return (block or list(offered))[-1]


__all__ = [
    "NETWORKS",
    "VGG16",
    "VGG19",
    "AlexNet",
    "Chosen",
    "EfficientNetLite0",
    "FeatureNetwork",
    "Texture",
    "choose",
    "load",
]
