"""Frozen networks, loaded by name for losses and metrics."""

from pathlib import Path

from anystyle.perception import weights
from anystyle.perception.alexnet import AlexNet
from anystyle.perception.features import FeatureNetwork, load_frozen
from anystyle.perception.texture import Texture
from anystyle.perception.vgg import VGG16, VGG19

NETWORKS: dict[str, type[FeatureNetwork]] = {
    "vgg19": VGG19,
    "vgg16": VGG16,
    "alexnet": AlexNet,
    "texture": Texture,
}
"""By name, which is also that of their weights in :mod:`anystyle.perception.weights`."""


def load(name: str, path: str | Path | None = None) -> FeatureNetwork:
    """A trained network, frozen.

    Args:
        name: ``vgg19``, ``vgg16``, ``alexnet`` or ``texture``.
        path: The file of its weights; ``None`` searches for it, see :func:`anystyle.perception.weights.find`.

    Raises:
        ValueError: There is no such network, or the file does not hold its weights.
        FileNotFoundError: Its weights are missing.
    """
    if name not in NETWORKS:
        raise ValueError(f"there is no perceptual network {name!r}; choose from {', '.join(NETWORKS)}")
    file = weights.find(name, path)
    network = NETWORKS[name]()
    # Published files hold the classifier too.
    state = {key: tensor for key, tensor in weights.read(file).items() if key.startswith("features.")}
    return load_frozen(network, state, file)


__all__ = ["NETWORKS", "VGG16", "VGG19", "AlexNet", "FeatureNetwork", "Texture", "load"]
