"""LPIPS (Zhang et al., CVPR 2018), version 0.1: a distance of images by the features of a network."""

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.types import Source
from anystyle.vision import networks, preprocess, weights
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.features import FeatureNetwork, Frozen
from anystyle.vision.weights import Weights, bundled, locate, published

LpipsBackbone = Literal["alex", "vgg"]

_VGG = ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")
NETWORKS = {"alex": ("alexnet", ("relu1", "relu2", "relu3", "relu4", "relu5")), "vgg": ("vgg16", _VGG)}
"""The network of each backbone, and the layers that are compared."""
STAND_IN_LAYERS = ("relu1_2", "relu2_2", "relu3_2", "relu4_1")
STAND_IN_SIDE = 128
"""Longest side in pixels that stand-ins see: they must be quick, not sharp."""


class Lpips(Frozen):
    """Weighted squared differences of features of unit length, averaged over pixels and added over layers.

    ``heads`` are the weights, one for each channel of each layer; images are shrunk to the side ``longest``.
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
        self.network, self.layers, self.source, self.longest = network, tuple(layers), source, longest
        for index, head in enumerate(heads):
            if bool((head < 0).any()):
                raise UserError(f"the weights of LPIPS' layer {index} have a negative value; none may")
            self.register_buffer(f"head{index}", head.sqrt().view(1, -1, 1, 1), persistent=False)

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> list[Float[Tensor, "M _ _ _"]]:
        """Features of images in [0, 1], of unit length, times the roots of the weights."""
        described: list[Tensor] = []
        for index, features in enumerate(self.network(preprocess.shrunk(images, self.longest), self.layers)):
            length = torch.linalg.vector_norm(features, dim=1, keepdim=True) + 1e-10
            features = features / length if torch.is_grad_enabled() else features.div_(length)
            described.append(features * self.get_buffer(f"head{index}"))
        return described

    def compare(
        self, preds: Sequence[Float[Tensor, "M _ _ _"]], target: Sequence[Float[Tensor, "M _ _ _"]]
    ) -> Float[Tensor, " M"]:
        """The distances of pairs of images, from their :meth:`describe`."""
        layers = [(one - other).square().sum(1).mean((1, 2)) for one, other in zip(preds, target, strict=True)]
        return torch.stack(layers).sum(0)

    def forward(self, preds: Float[Tensor, "M 3 H W"], target: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
        return self.compare(self.describe(preds), self.describe(target))

    def cached(
        self,
        preds: Float[Tensor, "M 3 H W"],
        target: Float[Tensor, "M 3 H W"],
        *,
        size: int | None,
        rounded: bool,
        gray: bool = False,
    ) -> Float[Tensor, " M"]:
        """The distances of images resized to a shorter side ``size`` unless it is ``None``; each is described once."""

        def described(images: Tensor) -> list[Tensor]:
            if size is not None:
                images = preprocess.resized(images, size, rounded=rounded)
            elif rounded:
                images = preprocess.eight_bit(images)
            return self.describe(preprocess.gray(images, rounded=rounded) if gray else images)

        key = ("lpips", self.source.identity, size, rounded, gray)
        return self.compare(*(CACHE.features(images, key, described) for images in (preds, target)))


def load(backbone: LpipsBackbone, choice: Weights = "auto") -> Lpips:
    """LPIPS with published weights, or with a stand-in: features of the texture network, all with equal weights."""
    name, layers = NETWORKS[backbone]
    file = locate(name, choice)
    if file is None:
        network = networks.load("texture")
        maps = network(torch.zeros(1, 3, 32, 32), STAND_IN_LAYERS)
        heads = [torch.full((features.shape[1],), 0.25) for features in maps]
        return Lpips(network, STAND_IN_LAYERS, heads, bundled(name, "texture_distance"), STAND_IN_SIDE)
    network = networks.load(name, file)
    channels = [features.shape[1] for features in network(torch.zeros(1, 3, 64, 64), layers)]
    heads_file = weights.find(f"lpips_{backbone}")
    state = weights.read(heads_file)
    heads = [state.get(f"lin{index}.model.1.weight", torch.empty(0)).flatten().float() for index in range(5)]
    if len(state) != 5 or [len(head) for head in heads] != channels:
        raise UserError(f"{heads_file} does not hold the heads of LPIPS for {channels} channels; get it again")
    return Lpips(network, layers, heads, published(name, file))
