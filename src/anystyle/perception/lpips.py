"""LPIPS (Zhang et al., CVPR 2018), version 0.1: a distance of images by the features of a network."""

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle import perception
from anystyle.perception import weights
from anystyle.perception.features import FeatureNetwork, Frozen
from anystyle.perception.preprocess import shrunk
from anystyle.perception.sources import Source, Weights, bundled, locate, published

Backbone = Literal["alex", "vgg"]

NETWORK = {"alex": "alexnet", "vgg": "vgg16"}
LAYERS = {
    "alex": ("relu1", "relu2", "relu3", "relu4", "relu5"),
    "vgg": ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3"),
}
STAND_IN_LAYERS = ("relu1_2", "relu2_2", "relu3_2", "relu4_1")
STAND_IN_SIDE = 128
"""Longest side in pixels that stand-ins see: they must be quick, not sharp."""


class Lpips(Frozen):
    """Weighted squared differences of features of unit length, averaged over pixels and added over layers.

    Args:
        network: Of the features.
        layers: The features that are compared.
        heads: For each layer, one weight a channel; none is negative.
        source: Of the weights.
        longest: Images are shrunk to this longest side in pixels; ``None`` leaves them as they are.
    """

    def __init__(
        self,
        network: FeatureNetwork,
        layers: Sequence[str],
        heads: Sequence[Float[Tensor, " _"]],
        source: Source,
        longest: int | None = None,
    ) -> None:
        super().__init__()
        self.network = network
        self.layers = tuple(layers)
        self.source = source
        self.longest = longest
        for index, head in enumerate(heads):
            if bool((head < 0).any()):
                raise ValueError(f"the weights of LPIPS' layer {index} have a negative value; none may")
            self.register_buffer(f"head{index}", head.sqrt().view(1, -1, 1, 1), persistent=False)

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> list[Float[Tensor, "M _ _ _"]]:
        """Features of images in [0, 1], of unit length, times the roots of the weights."""
        maps = self.network(shrunk(images, self.longest), self.layers)
        return [_unit(features, self.get_buffer(f"head{index}")) for index, features in enumerate(maps)]

    def compare(
        self, preds: Sequence[Float[Tensor, "M _ _ _"]], target: Sequence[Float[Tensor, "M _ _ _"]]
    ) -> Float[Tensor, " M"]:
        """The distances of pairs of images, from their :meth:`describe`."""
        layers = [(one - other).square().sum(1).mean((1, 2)) for one, other in zip(preds, target, strict=True)]
        return torch.stack(layers).sum(0)

    def forward(self, preds: Float[Tensor, "M 3 H W"], target: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        return self.compare(self.describe(preds), self.describe(target))


def _unit(features: Float[Tensor, "M C h w"], head: Float[Tensor, "1 C 1 1"]) -> Float[Tensor, "M C h w"]:
    """Features of unit length times the roots of the weights; in place where there are no gradients."""
    length = torch.linalg.vector_norm(features, dim=1, keepdim=True) + 1e-10
    if torch.is_grad_enabled():
        return features / length * head
    return features.div_(length).mul_(head)


def load(backbone: Backbone, choice: Weights = "auto") -> Lpips:
    """LPIPS over a network, with published weights or with a stand-in of its own.

    Args:
        backbone: ``alex`` or ``vgg``.
        choice: Of weights; the stand-in compares features of the bundled texture network, all with equal weights.

    Raises:
        FileNotFoundError: The weights are missing and no stand-in is allowed.
        ValueError: A file does not hold them.
    """
    name = NETWORK[backbone]
    file = locate(name, choice)
    if file is None:
        network = perception.load("texture")
        maps = network(torch.zeros(1, 3, 32, 32), STAND_IN_LAYERS)
        heads = [torch.full((features.shape[1],), 0.25) for features in maps]
        return Lpips(network, STAND_IN_LAYERS, heads, bundled(name, "texture_distance"), STAND_IN_SIDE)
    network = perception.load(name, file)
    maps = network(torch.zeros(1, 3, 64, 64), LAYERS[backbone])
    heads = _heads(f"lpips_{backbone}", [features.shape[1] for features in maps])
    return Lpips(network, LAYERS[backbone], heads, published(name, file))


def _heads(name: str, channels: Sequence[int]) -> list[Tensor]:
    file = weights.find(name)
    state = weights.read(file)
    heads = [state.get(f"lin{index}.model.1.weight") for index in range(len(channels))]
    if len(state) != len(channels) or any(
        head is None or head.numel() != width for head, width in zip(heads, channels, strict=True)
    ):
        raise ValueError(f"{file} does not hold the heads of LPIPS for {list(channels)} channels; get it again")
    return [head.flatten().float() for head in heads if head is not None]
