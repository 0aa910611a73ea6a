"""Frozen networks behind one door: losses and metrics ask for them by name."""

from pathlib import Path

from anystyle.perception import weights
from anystyle.perception.alexnet import AlexNet
from anystyle.perception.features import FeatureNetwork, load_strictly
from anystyle.perception.texture import Texture
from anystyle.perception.vgg import VGG16, VGG19

NETWORKS: dict[str, type[FeatureNetwork]] = {
    "vgg19": VGG19,
    "vgg16": VGG16,
    "alexnet": AlexNet,
    "texture": Texture,
}
"""The networks that :func:`load` knows; the weights of each are under the same name in ``weights.FILES``."""


def load(name: str, path: str | Path | None = None) -> FeatureNetwork:
    """A trained network, frozen.

    Args:
        name: ``vgg19``, ``vgg16``, ``alexnet`` or ``texture``.
        path: Its file of weights, if not where :func:`anystyle.perception.weights.find` looks.

    Raises:
        ValueError: There is no such network, or the file does not hold its weights.
        FileNotFoundError: Its weights are missing; no other network takes its place.
    """
    if name not in NETWORKS:
        raise ValueError(f"there is no perceptual network {name!r}; choose from {', '.join(NETWORKS)}")
    file = weights.find(name, path)
    network = NETWORKS[name]()
    # Published files carry the classifier too; everything under `features` must fit to the last key.
    state = {key: tensor for key, tensor in weights.read(file).items() if key.startswith("features.")}
    return load_strictly(network, state, name=name, file=file)


__all__ = ["NETWORKS", "VGG16", "VGG19", "AlexNet", "FeatureNetwork", "Texture", "load"]
