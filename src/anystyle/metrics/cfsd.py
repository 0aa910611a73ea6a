"""CFSD: whether places of an image that were alike are alike after stylization (Chung et al., StyleID, CVPR 2024)."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle import perception
from anystyle.metrics._mean import RowMean
from anystyle.metrics._pairs import Pairs, gathered
from anystyle.perception import pictures
from anystyle.perception.features import FeatureNetwork
from anystyle.perception.lpips import STAND_IN_SIDE, shrunk
from anystyle.perception.memo import MEMO
from anystyle.perception.sources import Weights, bundled, checksums, locate, published, stand_ins
from anystyle.perception.winograd import quicken
from anystyle.types import Comparison

CHUNK = 1 << 25
"""Similarities that are held at once, row by row: 128 MiB in single precision."""

SIDE = 512
"""Of a block of similarities; what is done to one stays in the cache."""

STEEP = 40.0
"""Similarities up to here have exponentials that single precision adds up without loss."""


class CFSD(RowMean):
    """Content feature structural distance: relative entropy of the self-similarities of VGG-19 features (``relu3_1``).

    Every place of the photograph has a distribution over all places, the softmax of inner products of features that
    were divided by their number; so has every place of the stylized image. Summed over places, as published, not
    averaged: a larger image has a larger distance. Similarities are computed in parts, so that memory does not grow
    with the square of the image.

    Args:
        variant: ``reference`` sums over places and has images of 8 bits; ``corrected`` averages over places and rounds
            nothing, so that sizes can be compared.
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {"cfsd": "lower"}
    higher_is_better = False

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference", weights: Weights = "auto") -> None:
        super().__init__()
        self.reference = variant == "reference"
        file = locate("vgg19", weights)
        self.network: FeatureNetwork = quicken(perception.load("texture" if file is None else "vgg19", file))
        self.layer = "relu3_1"
        self.longest = STAND_IN_SIDE if file is None else None
        self._source = bundled("vgg19", "texture_similarity") if file is None else published("vgg19", file)
        self.stand_ins = stand_ins(self.better, self._source)
        self.weights = checksums(self._source)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Stand-ins: quick, and the same everywhere."""
        return {"weights": "stand_in"}

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views."""
        return gathered(comparison, self._distances)

    def _distances(self, some: Pairs) -> Float[Tensor, " M"]:
        what = ("cfsd", self._source.identity, self.reference)
        content = MEMO.rows(some.content, some.content_marks, what, lambda x: [self._features(x)])[0]
        stylized = self._features(some.stylized)
        found = torch.stack([structural_distance(*pair) for pair in zip(stylized, content, strict=True)])
        return found if self.reference else found / content[0, 0].numel()

    def _features(self, images: Tensor) -> Tensor:
        images = pictures.eight_bit(images) if self.reference else images
        return self.network(shrunk(images, self.longest), (self.layer,))[0]


def structural_distance(stylized: Float[Tensor, "C h w"], content: Float[Tensor, "C h w"]) -> Float[Tensor, ""]:
    """Relative entropy of the content's self-similarities to the stylized ones, summed over all places.

    The published ``PatchSimi``: ``sum p_content (log p_content - log p_stylized)`` with ``p`` the rows of
    ``softmax(F Fᵀ)``, features ``F`` divided by the channels.

    Similarities are symmetric, so each block of them is computed once and counts for its rows and for its columns.
    """
    first, second = (features.flatten(1) / features.shape[0] for features in (stylized, content))  # C S
    places = first.shape[1]
    # By Cauchy and Schwarz, no similarity is larger than this.
    if float(max(rows.square().sum(0).max() for rows in (first, second))) > STEEP:
        return _row_by_row(first, second)
    weight, change, gap = first.new_zeros(3, places, dtype=torch.float64)
    room = first.new_empty(3, SIDE, SIDE)
    for start in range(0, places, SIDE):
        rows = slice(start, start + SIDE)
        for begin in range(start, places, SIDE):
            columns = slice(begin, begin + SIDE)
            blocks = _block(first, second, rows, columns, room)
            for total, block in zip((weight, change, gap), blocks, strict=True):
                total[rows] += block.sum(1)
                if begin > start:
                    total[columns] += block.sum(0)
    # With weights w = exp(content) and d = content - stylized, a row's entropy is
    # sum(w d) / sum(w) + log(sum(w exp(-d)) / sum(w)); both are of first order in d, what is left of them of second.
    ratio = change / weight
    return (gap / weight + (ratio.log1p() - ratio)).sum()


def _block(
    first: Tensor, second: Tensor, rows: slice, columns: slice, room: Float[Tensor, "3 _ _"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Of some similarities the weights w, ``w (exp(-d) - 1)`` and ``w (d + exp(-d) - 1)``, where there is room."""
    weight, gap, change = room[:, : second[:, rows].shape[1], : second[:, columns].shape[1]]
    torch.mm(second[:, rows].mT, second[:, columns], out=weight)
    torch.addmm(weight, first[:, rows].mT, first[:, columns], beta=-1, out=gap)  # -d
    torch.expm1(gap, out=change)
    weight.exp_()
    torch.sub(change, gap, out=gap).mul_(weight)
    return weight, change.mul_(weight), gap


def _row_by_row(first: Float[Tensor, "C S"], second: Float[Tensor, "C S"]) -> Float[Tensor, ""]:
    """The same where similarities differ by so much that each row needs a shift of its own."""
    places = first.shape[1]
    rows = max(1, CHUNK // places)
    total = first.new_zeros((), dtype=torch.float64)
    for start in range(0, places, rows):
        part = slice(start, start + rows)
        found = (first[:, part].mT @ first).log_softmax(-1)
        wanted = (second[:, part].mT @ second).log_softmax(-1)
        total += (wanted.exp() * (wanted - found)).sum(dtype=torch.float64)
    return total
