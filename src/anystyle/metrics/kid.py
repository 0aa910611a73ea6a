"""KID: the distance of the styles' features that is unbiased for few images (Bińkowski et al., ICLR 2018)."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.metrics._pairs import checked, pairs, style_images
from anystyle.perception import pictures, vectors
from anystyle.perception.memo import MEMO, fingerprints
from anystyle.perception.sources import Weights, checksums, stand_ins
from anystyle.types import Comparison


class KID(Metric):
    """Squared maximum mean discrepancy, with a cubic kernel, of stylized and style images.

    Unbiased at any number of images, in one estimate over all of them. A style image counts once: copies of one image
    are no independent samples.

    Args:
        size: Pixels of the shorter side that images are resized to; 299 as in the network's training.
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {"kid": "lower"}
    higher_is_better = False
    is_differentiable = False
    full_state_update = False
    stylized: list[Tensor]
    style: list[Tensor]

    def __init__(self, *, size: int = 299, weights: Weights = "auto") -> None:
        super().__init__()
        if size < 75:
            raise ValueError(f"kid.size is {size}; the network reads 75 pixels and more")
        self.size = size
        self.inception = vectors.load_art_inception(weights)
        self.stand_ins = stand_ins(self.better, self.inception.source)
        self.weights = checksums(self.inception.source)
        self.add_state("stylized", [], dist_reduce_fx="cat")
        self.add_state("style", [], dist_reduce_fx="cat")

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Stand-ins: quick, and the same everywhere."""
        return {"weights": "stand_in"}

    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        """See :meth:`anystyle.contracts.Metric.update`; rows without a style image are left out."""
        image, given = style_images(checked(comparison))
        for some in pairs(comparison):
            if bool(given[some.row]):
                self.stylized.append(self._vectors(some.stylized, some.stylized_marks))
        self.style.append(self._vectors(image[given], fingerprints(image[given])))

    def compute(self) -> dict[str, Tensor]:
        """See :meth:`anystyle.contracts.Metric.compute`; ``nan`` with fewer than two images or styles."""
        stylized, style = _stacked(self.stylized), _stacked(self.style)
        style = style.unique(dim=0)
        if min(stylized.shape[0], style.shape[0]) < 2:
            warnings.warn(
                f"kid: {stylized.shape[0]} stylized and {style.shape[0]} distinct style images; two of each are "
                "needed, the figure is nan",
                stacklevel=2,
            )
            return {"kid": torch.full((), float("nan"), device=stylized.device)}
        return {"kid": discrepancy(stylized, style).float()}

    def _vectors(self, images: Tensor, marks: list[str]) -> Tensor:
        def look(some: Tensor) -> list[Tensor]:
            return [self.inception(pictures.resized(some, self.size, rounded=False))]

        what = ("inception", self.inception.source.identity, self.size, False)
        return MEMO.rows(images, marks, what, look)[0]


def discrepancy(first: Float[Tensor, "N D"], second: Float[Tensor, "M D"]) -> Float[Tensor, ""]:
    """The unbiased estimate of the squared maximum mean discrepancy for the kernel ``(x y / D + 1)^3``, in float64."""
    first, second = first.double(), second.double()

    def kernel(one: Tensor, other: Tensor) -> Tensor:
        return (one @ other.mT / one.shape[1] + 1) ** 3

    def within(rows: Tensor) -> Tensor:
        table = kernel(rows, rows)
        return (table.sum() - table.diagonal().sum()) / (rows.shape[0] * (rows.shape[0] - 1))

    return within(first) + within(second) - 2 * kernel(first, second).mean()


def _stacked(parts: list[Tensor] | Tensor) -> Float[Tensor, "N D"]:
    # After a reduction over processes the list has become one tensor.
    if torch.is_tensor(parts):
        return parts
    return torch.cat(parts) if parts else torch.zeros(0, 1)
