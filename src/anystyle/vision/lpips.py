"""LPIPS (Zhang et al., CVPR 2018), version 0.1: a distance of images by the features of a network.

Where its published weights are missing, ST-LPIPS replaces it if the package ``stlpips-pytorch`` is installed, whose
files are read and whose code is not; else the bundled texture network does.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.types import Source
from anystyle.vision import networks, preprocess, st_lpips, weights
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.features import FeatureNetwork, Frozen, load_frozen
from anystyle.vision.weights import MissingWeights, Weights, bundled, locate, published

log = logging.getLogger(__name__)

LpipsBackbone = Literal["alex", "vgg"]

_VGG = ("relu1_2", "relu2_2", "relu3_3", "relu4_3", "relu5_3")
NETWORKS = {"alex": ("alexnet", ("relu1", "relu2", "relu3", "relu4", "relu5")), "vgg": ("vgg16", _VGG)}
"""The network of each backbone, and the layers that are compared."""
STAND_IN_LAYERS = ("relu1_2", "relu2_2", "relu3_2", "relu4_1")
STAND_IN_SIDE = 128
"""Longest side in pixels that stand-ins see: they must be quick, not sharp."""
ST_NETWORKS = {"alex": st_lpips.ShiftTolerantAlexNet, "vgg": st_lpips.ShiftTolerantVGG16}
ST_SIDE = 96
"""Longest side in pixels that ST-LPIPS sees, to be as quick; it learnt from patches of 64 x 64."""


class Lpips(Frozen):
    """Weighted squared differences of features of unit length, averaged over pixels and added over layers.

    ``heads`` are the weights, one for each channel of each layer; images are shrunk to the side ``longest``; scores
    call the distance by its ``name``.
    """

    def __init__(
        self,
        network: FeatureNetwork,
        layers: Sequence[str],
        heads: Sequence[Float[Tensor, " _"]],
        source: Source,
        longest: int | None = None,
        name: str = "lpips",
    ) -> None:
        super().__init__()
        self.network, self.layers, self.source = network, tuple(layers), source
        self.longest, self.name = longest, name
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
        layers = [
            (one - other).square().sum((1, 2, 3)) / one[0, 0].numel() for one, other in zip(preds, target, strict=True)
        ]
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
    """LPIPS with published weights, or what replaces it where ``auto`` misses these: ST-LPIPS, else a stand-in.

    The stand-in compares features of the texture network, all with equal weights.
    """
    name, layers = NETWORKS[backbone]
    file = locate(name, choice)
    if file is None and choice == "auto":
        try:
            return _shift_tolerant(backbone, weights.find(f"st_lpips_{backbone}"))
        except MissingWeights as error:
            log.warning("ST-LPIPS would replace LPIPS better than the stand-in: %s", error)
    if file is None:
        network = networks.load("texture")
        maps = network(torch.zeros(1, 3, 32, 32), STAND_IN_LAYERS)
        heads = [torch.full((features.shape[1],), 0.25) for features in maps]
        return Lpips(network, STAND_IN_LAYERS, heads, bundled(name, "texture_distance"), STAND_IN_SIDE)
    network, heads_file = networks.load(name, file), weights.find(f"lpips_{backbone}")
    heads = _heads(network, layers, weights.read(heads_file), heads_file)
    return Lpips(network, layers, heads, published(name, file))


def _shift_tolerant(backbone: LpipsBackbone, file: Path) -> Lpips:
    (name, layers), state = NETWORKS[backbone], weights.read(file)
    network = load_frozen(ST_NETWORKS[backbone](), st_lpips.trunk(state), file)
    heads = _heads(network, layers, {key: state[key] for key in state if key.startswith("lin")}, file)
    source = replace(published(f"st_lpips_{backbone}", file), network=name, stand_in="st_lpips")
    return Lpips(network, layers, heads, source, ST_SIDE, "st_lpips")


def _heads(
    network: FeatureNetwork, layers: Sequence[str], state: Mapping[str, Tensor], file: Path
) -> list[Float[Tensor, " _"]]:
    channels = [features.shape[1] for features in network(torch.zeros(1, 3, 64, 64), layers)]
    heads = [state.get(f"lin{index}.model.1.weight", torch.empty(0)).flatten().float() for index in range(5)]
    if len(state) != 5 or [len(head) for head in heads] != channels:
        raise UserError(f"{file} does not hold the heads of LPIPS for {channels} channels; get it again")
    return heads
