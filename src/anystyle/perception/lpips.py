"""LPIPS (Zhang et al., CVPR 2018), version 0.1: a distance of images that looks at them through a network."""

from collections.abc import Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle import perception
from anystyle.perception import weights
from anystyle.perception.features import FeatureNetwork, Frozen
from anystyle.perception.sources import Source, Weights, bundled, locate, published
from anystyle.perception.winograd import quicken

Backbone = Literal["alex", "vgg"]

NETWORK = {"alex": "alexnet", "vgg": "vgg16"}
LAYERS = {
    "alex": ("relu1", "relu2", "relu3", "relu4", "relu5"),
    "vgg": ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3"),
}
STAND_IN_LAYERS = ("relu1_2", "relu2_2", "relu3_2", "relu4_1")
STAND_IN_SIDE = 128
"""The longest side that stand-ins look at: they must be quick, not sharp."""


class Lpips(Frozen):
    """Weighted squared differences of features of unit length, averaged over places and added over layers.

    Args:
        network: Whose features.
        layers: Which of them.
        heads: For each layer, one weight a channel; none is negative.
        source: Of the weights.
        longest: Larger images are made smaller before; ``None`` leaves them as they are.
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
        for place, head in enumerate(heads):
            if bool((head < 0).any()):
                raise ValueError(f"the weights of LPIPS' layer {place} have a negative value; none may")
            self.register_buffer(f"head{place}", head.sqrt().view(1, -1, 1, 1), persistent=False)

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> list[Float[Tensor, "M _ _ _"]]:
        """What images in [0, 1] are compared by: unit features times the roots of the weights."""
        maps = self.network(shrunk(images, self.longest), self.layers)
        return [_unit(features, self.get_buffer(f"head{place}")) for place, features in enumerate(maps)]

    def compare(self, first: Sequence[Float[Tensor, "M _ _ _"]], second: Sequence[Float[Tensor, "M _ _ _"]]) -> Tensor:
        """The distances ``M`` of images that were described."""
        total = first[0].new_zeros(first[0].shape[0])
        for one, other in zip(first, second, strict=True):
            # Image by image: what is as large as the features of several is slow to get from the system.
            rows = [torch.linalg.vector_norm(a - b, dim=0).square().mean() for a, b in zip(one, other, strict=True)]
            total = total + torch.stack(rows)
        return total

    def forward(self, first: Float[Tensor, "M 3 H W"], second: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        """The distances of pairs of images in [0, 1]."""
        return self.compare(self.describe(first), self.describe(second))


def _unit(features: Float[Tensor, "M C h w"], head: Float[Tensor, "1 C 1 1"]) -> Float[Tensor, "M C h w"]:
    """Features of unit length times the roots of the weights; in place where nobody asks for gradients."""
    length = torch.linalg.vector_norm(features, dim=1, keepdim=True) + 1e-10
    if torch.is_grad_enabled():
        return features / length * head
    return features.div_(length).mul_(head)


def load(backbone: Backbone, choice: Weights = "auto") -> Lpips:
    """LPIPS over a network, with published weights or with a stand-in of its own.

    Args:
        backbone: ``alex`` or ``vgg``.
        choice: Of weights; the stand-in compares features of the bundled network of textures, all alike.

    Raises:
        FileNotFoundError: The weights are missing and no stand-in is wanted.
        ValueError: A file does not hold them.
    """
    name = NETWORK[backbone]
    file = locate(name, choice)
    if file is None:
        network = perception.load("texture")
        maps = network(torch.zeros(1, 3, 32, 32), STAND_IN_LAYERS)
        heads = [torch.full((found.shape[1],), 0.25) for found in maps]
        return Lpips(network, STAND_IN_LAYERS, heads, bundled(name, "texture_distance"), STAND_IN_SIDE)
    network = quicken(perception.load(name, file))
    maps = network(torch.zeros(1, 3, 64, 64), LAYERS[backbone])
    heads = _heads(f"lpips_{backbone}", [found.shape[1] for found in maps])
    return Lpips(network, LAYERS[backbone], heads, published(name, file))


def _heads(name: str, channels: Sequence[int]) -> list[Tensor]:
    file = weights.find(name)
    state = weights.read(file)
    heads = [state.get(f"lin{place}.model.1.weight") for place in range(len(channels))]
    if len(state) != len(channels) or any(
        head is None or head.numel() != count for head, count in zip(heads, channels, strict=True)
    ):
        raise ValueError(f"{file} does not hold the heads of LPIPS for {list(channels)} channels; get it again")
    return [head.flatten().float() for head in heads if head is not None]


def shrunk(images: Float[Tensor, "M 3 H W"], longest: int | None) -> Float[Tensor, "M 3 h w"]:
    """Images whose longest side is at most ``longest``, their shape kept."""
    height, width = images.shape[-2:]
    if longest is None or max(height, width) <= longest:
        return images
    factor = longest / max(height, width)
    size = (max(1, round(height * factor)), max(1, round(width * factor)))
    return F.interpolate(images, size=size, mode="bilinear", align_corners=False, antialias=True)
