"""Structure distance: whether parts of a photograph that were alike are alike in its stylization."""

from collections.abc import Mapping
from typing import ClassVar

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import NetworkMetric, Pairs, RowMean, mean_per_row
from anystyle.types import Comparison
from anystyle.vision import preprocess
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.weights import Weights
from anystyle_metrics import dino

SHORT_SIDE = 224  # pixels, as published


class StructureDistance(NetworkMetric, RowMean):
    """Mean squared difference of the self-similarities of DINO ViT-B/8's keys (Tumanyan et al., Splice, CVPR 2022).

    An image's self-similarities are the cosines of the last layer's keys of every two tokens (arXiv 2201.00424, section
    3); photograph and stylized image are compared entry by entry, in [0, 4], as the authors' code does; the paper has
    the Frobenius norm of the same difference. Images have a shorter side of 224 pixels.

    The stand-in has the activations of EfficientNet-Lite0's block 12 in the place of keys, without a class token. Its
    scores are in the same range, and comparable with one another only.

    Args:
        weights: ``auto`` falls back to the stand-in, with a warning, where the published ones are missing.

    Example:
        >>> import torch
        >>> image = torch.rand(1, 3, 64, 64)
        >>> StructureDistance(weights="stand_in")(image, image)
        tensor(0.)
    """

    better: ClassVar[Mapping[str, str]] = {"structure_distance": "lower"}
    takes = ("preds", "target")

    def __init__(self, *, weights: Weights = "auto") -> None:
        super().__init__()
        self.network, self._source = dino.load("dino_vitb8", weights)
        self.declare(self._source)

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        return mean_per_row(comparison, self._distances)

    def _distances(self, batch: Pairs) -> Float[Tensor, " M"]:
        key = ("structure", self._source.identity)
        target = CACHE.features(batch.target, key, lambda images: [self._similarities(images)])[0]
        return (self._similarities(batch.preds) - target).square().mean((1, 2))

    def _similarities(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M L L"]:
        keys = F.normalize(self.network.keys(preprocess.resized(images, SHORT_SIDE, mode="bicubic")), dim=-1)
        return keys @ keys.mT
