"""CFSD: whether parts of an image that were alike are alike after stylization (Chung et al., StyleID, CVPR 2024)."""

from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import NetworkMetric, Pairs, RowMean, mean_per_row
from anystyle.types import Comparison
from anystyle.vision import networks, preprocess
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.lpips import STAND_IN_SIDE
from anystyle.vision.weights import Weights, bundled, locate, published

MAX_SIMILARITIES = 1 << 25
"""In memory at once, row by row: 128 MiB in single precision."""

BLOCK = 512
"""Side of a block of similarities, which fits a CPU's cache."""

MAX_EXPONENT = 40.0
"""Exponentials of similarities up to here are summed in single precision without loss."""


class CFSD(NetworkMetric, RowMean):
    """Content feature structural distance: relative entropy of the self-similarities of VGG-19 features (``relu3_1``).

    ``sum p (log p - log q)``, at least 0: every pixel of the photograph's features has a distribution p over all
    pixels, the softmax of inner products of features that were divided by their number of channels; so has every pixel
    of the stylized image's, q. Summed over pixels, as published, not averaged: a larger image has a larger distance.
    Similarities are computed in parts, so that memory does not grow with the square of the image.

    Args:
        variant: ``reference`` sums over pixels and has images of 8 bits; ``corrected`` averages over pixels and rounds
            nothing, so that sizes can be compared.
        weights: ``auto`` falls back to a stand-in, with a warning, where the published ones are missing.

    Example:
        >>> images = torch.rand(1, 3, 32, 32)
        >>> metric = CFSD(weights="stand_in")
        >>> metric.update(images, images)
        >>> print(f"{metric.compute():.3f}")
        0.000
    """

    better: ClassVar[Mapping[str, str]] = {"cfsd": "lower"}
    takes = ("preds", "target")

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference", weights: Weights = "auto") -> None:
        super().__init__()
        self.reference = variant == "reference"
        file = locate("vgg19", weights)
        self.network = networks.load("texture" if file is None else "vgg19", file)
        self.layer = "relu3_1"
        self.longest = STAND_IN_SIDE if file is None else None
        self._source = bundled("vgg19", "texture_similarity") if file is None else published("vgg19", file)
        self.declare(self._source)

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        return mean_per_row(comparison, self._distances)

    def _distances(self, batch: Pairs) -> Float[Tensor, " M"]:
        key = ("cfsd", self._source.identity, self.reference)
        target = CACHE.features(batch.target, key, lambda images: [self._features(images)])[0]
        preds = self._features(batch.preds)
        distances = torch.stack([structural_distance(*pair) for pair in zip(preds, target, strict=True)])
        return distances if self.reference else distances / target[0, 0].numel()

    def _features(self, images: Tensor) -> Tensor:
        images = preprocess.eight_bit(images) if self.reference else images
        return self.network(preprocess.shrunk(images, self.longest), (self.layer,))[0]


def structural_distance(preds: Float[Tensor, "C h w"], target: Float[Tensor, "C h w"]) -> Float[Tensor, ""]:
    """Relative entropy of the content's self-similarities to the stylized ones, summed over all pixels.

    The published ``PatchSimi``: ``sum p_content (log p_content - log p_stylized)`` with ``p`` the rows of
    ``softmax(F Fᵀ)``, features ``F`` divided by their number of channels.

    Similarities are symmetric, so each block of them is computed once and counts for its rows and for its columns.
    """
    preds, target = (features.flatten(1) / features.shape[0] for features in (preds, target))  # C S
    num_pixels = preds.shape[1]
    # By Cauchy and Schwarz, no similarity is larger than this.
    if float(max(features.square().sum(0).max() for features in (preds, target))) > MAX_EXPONENT:
        return _row_by_row(preds, target)
    weight, first_order, second_order = preds.new_zeros(3, num_pixels, dtype=torch.float64)
    buffer = preds.new_empty(3, BLOCK, BLOCK)
    for top in range(0, num_pixels, BLOCK):
        rows = slice(top, top + BLOCK)
        for left in range(top, num_pixels, BLOCK):
            columns = slice(left, left + BLOCK)
            blocks = _block(preds, target, rows, columns, buffer)
            for total, block in zip((weight, first_order, second_order), blocks, strict=True):
                total[rows] += block.sum(1)
                if left > top:
                    total[columns] += block.sum(0)
    # With weights w = exp(content) and d = content - stylized, a row's entropy is
    # sum(w d) / sum(w) + log(sum(w exp(-d)) / sum(w)). Both terms are of first order in d and their sum is of second:
    # log(1 + x) - x is taken with x = sum(w (exp(-d) - 1)) / sum(w), and the first orders cancel before rounding.
    x = first_order / weight
    return (second_order / weight + (x.log1p() - x)).sum()


def _block(
    preds: Float[Tensor, "C S"],
    target: Float[Tensor, "C S"],
    rows: slice,
    columns: slice,
    buffer: Float[Tensor, "3 _ _"],
) -> tuple[Tensor, Tensor, Tensor]:
    """The weights w of some similarities, ``w (exp(-d) - 1)`` and ``w (d + exp(-d) - 1)``, written to a buffer."""
    weight, minus_d, first_order = buffer[:, : target[:, rows].shape[1], : target[:, columns].shape[1]]
    torch.mm(target[:, rows].mT, target[:, columns], out=weight)
    torch.addmm(weight, preds[:, rows].mT, preds[:, columns], beta=-1, out=minus_d)
    torch.expm1(minus_d, out=first_order)
    weight.exp_()
    second_order = torch.sub(first_order, minus_d, out=minus_d).mul_(weight)
    return weight, first_order.mul_(weight), second_order


def _row_by_row(preds: Float[Tensor, "C S"], target: Float[Tensor, "C S"]) -> Float[Tensor, ""]:
    """The same where similarities differ by so much that each row's softmax needs a shift of its own."""
    total = preds.new_zeros((), dtype=torch.float64)
    for rows in torch.arange(preds.shape[1]).split(max(1, MAX_SIMILARITIES // preds.shape[1])):
        log_preds, log_target = ((each[:, rows].mT @ each).log_softmax(-1) for each in (preds, target))
        total += F.kl_div(log_preds, log_target, reduction="none", log_target=True).sum(dtype=torch.float64)
    return total
