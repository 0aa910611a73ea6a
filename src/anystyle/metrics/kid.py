"""KID: the distance of the styles' features that is unbiased for few images (Bińkowski et al., ICLR 2018)."""

import warnings
from collections.abc import Mapping
from functools import partial
from typing import Annotated, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import accepts_tensors
from anystyle.metrics.base import NetworkMetric, pairs, stacked, with_style_images
from anystyle.ranges import Range
from anystyle.types import Comparison
from anystyle.vision import embeddings
from anystyle.vision.weights import Weights


class KID(NetworkMetric):
    """Squared maximum mean discrepancy, with a cubic kernel, of stylized and style images.

    Unbiased at any number of images, in one estimate over all of them. A style image counts once: copies of one image
    are not independent samples.

    Args:
        size: Pixels of the shorter side that images are resized to; 299 as in the network's training.
        weights: ``auto`` falls back to a stand-in, with a warning, where the published ones are missing.

    Example:
        >>> images = torch.rand(2, 3, 75, 75, generator=torch.Generator().manual_seed(0))
        >>> metric = KID(weights="stand_in", size=75)
        >>> metric.update(images, images)  # unbiased: equal sets may be below 0
        >>> print(f"{metric.compute():.1f}")
        -0.1
    """

    better: ClassVar[Mapping[str, str]] = {"kid": "lower"}
    takes = ("preds", "style")
    stylized: list[Tensor]
    style: list[Tensor]

    def __init__(self, *, size: Annotated[int, Range(ge=75)] = 299, weights: Weights = "auto") -> None:
        super().__init__()
        self.size = size
        self.inception = embeddings.load_art_inception(weights)
        self.declare(self.inception.source)
        self.add_state("stylized", [], dist_reduce_fx="cat")
        self.add_state("style", [], dist_reduce_fx="cat")

    @accepts_tensors
    def update(self, comparison: Comparison) -> None:
        comparison, style = with_style_images(comparison)
        vectors = partial(self.inception.vectors, size=self.size, rounded=False)
        self.stylized += [vectors(batch.preds) for batch in pairs(comparison)]
        self.style.append(vectors(style))

    def compute(self) -> Tensor:
        stylized, style = stacked(self.stylized), stacked(self.style).unique(dim=0)
        if min(stylized.shape[0], style.shape[0]) < 2:
            warnings.warn(
                f"kid: {stylized.shape[0]} stylized and {style.shape[0]} distinct style images; two of each are "
                "needed, the score is nan",
                stacklevel=2,
            )
            return torch.full((), float("nan"), device=stylized.device)
        return discrepancy(stylized, style).float()


def discrepancy(first: Float[Tensor, "N D"], second: Float[Tensor, "M D"]) -> Float[Tensor, ""]:
    """The unbiased estimate of the squared maximum mean discrepancy for the kernel ``(x y / D + 1)^3``, in float64."""
    first, second = first.double(), second.double()

    def kernel(one: Tensor, other: Tensor) -> Tensor:
        return (one @ other.mT / one.shape[1] + 1) ** 3

    def within(rows: Tensor) -> Tensor:
        table = kernel(rows, rows)
        return (table.sum() - table.diagonal().sum()) / (rows.shape[0] * (rows.shape[0] - 1))

    return within(first) + within(second) - 2 * kernel(first, second).mean()
