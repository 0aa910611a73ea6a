"""Frozen networks behind one door: losses and metrics ask for them by name."""

from pathlib import Path

from anystyle.perception import weights
from anystyle.perception.features import FeatureNetwork, freeze
from anystyle.perception.texture import Texture
from anystyle.perception.vgg import VGG19

NETWORKS: dict[str, type[FeatureNetwork]] = {"vgg19": VGG19, "texture": Texture}
"""The networks that :func:`load` knows; the weights of each are under the same name in ``weights.FILES``."""


def load(name: str, path: str | Path | None = None) -> FeatureNetwork:
    """A trained network, frozen.

    Args:
        name: ``vgg19`` or ``texture``.
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
    own = network.state_dict()
    wrong = sorted(
        key
        for key in own.keys() | state.keys()
        if key not in own or key not in state or own[key].shape != state[key].shape
    )
    if wrong:
        shown = ", ".join(wrong[:5]) + (", …" if len(wrong) > 5 else "")
        raise ValueError(f"{file} does not hold the weights of {name}: {len(wrong)} keys differ ({shown})")
    network.load_state_dict(state)
    return freeze(network.train(False))


__all__ = ["NETWORKS", "VGG19", "FeatureNetwork", "Texture", "load"]
