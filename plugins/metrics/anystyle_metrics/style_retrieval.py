"""Style retrieval: whether the style image nearest to a stylized scene is its own."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.vision import networks
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.preprocess import middle_square
from anystyle.vision.statistics import equalized_gray
from anystyle.vision.weights import checksums, find, published
from anystyle_metrics.style_sets import StyleSet, named

LAYERS = ("expand3", "expand5", "expand8")
"""Of the sets of EfficientNet-Lite0 tried these find the other half of the same painting most often: among 61 paintings
in 82 % of cases, and in 70 % in equalised grey; the first four blocks in 70 % and 57 %."""
SIDE = 224
"""Sides in pixels of the square that is looked at, as in the network's training."""


class Retrieval(StyleSet):
    """The share of stylized scenes whose style image is the nearest of all, in colour and in equalised grey.

    Measured in gray as well, so that matching the palette alone does not score. A row is described by the mean of its
    views' vectors. Rows are centred over all styles of their scene, style images over all of theirs, so that what a
    scene shows does not count. Chance is one over the number of style images, and scores of other numbers cannot be
    compared. ``*_csls`` is the share after a correction for hubs, ``*_gap`` how far the styles are apart: see
    :class:`~anystyle_metrics.style_sets.StyleSet`.

    A subclass defines the vectors, and names the scores in :attr:`better`, colour first.
    """

    @abstractmethod
    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Vectors of sRGB images in [0, 1]."""

    def vectors(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 2 D"]:
        def look(batch: Tensor) -> list[Tensor]:
            return [torch.stack([self.describe(seen) for seen in (batch, equalized_gray(batch))], dim=1)]

        return CACHE.features(images, ("retrieval", *self.better, *self.weights.values()), look)[0].double()

    def similar(self, rows: Float[Tensor, "N D"], styles: Float[Tensor, "G D"]) -> Float[Tensor, "N G"]:
        """Cosines, each side centred over its own set: what all of it share is removed."""
        return F.normalize(rows - rows.mean(0), dim=-1) @ F.normalize(styles - styles.mean(0), dim=-1).mT

    def value(self, similar: Float[Tensor, "N G"], own: Int[Tensor, " N"]) -> Float[Tensor, " N"]:
        """1 for each row that is nearest to its own style, else 0; ``nan`` for the only row or style."""
        hits = (similar.argmax(1) == own).double()
        return hits if min(similar.shape) > 1 else hits * torch.nan


class StyleRetrieval(Retrieval):
    """:class:`Retrieval` by means and deviations of EfficientNet-Lite0's features.

    A judge of what was not trained with that network; ``magenta_retrieval`` is another.

    Example:
        >>> fine = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0))
        >>> images = torch.cat([fine, fine[..., :4, :4].repeat_interleave(16, -1).repeat_interleave(16, -2)])
        >>> metric = StyleRetrieval()
        >>> metric.update(images, images)
        >>> metric.compute()["style_retrieval"]  # results are their style images
        tensor(1.)
    """

    better: ClassVar[Mapping[str, str]] = named("style_retrieval", "style_retrieval_gray")

    def __init__(self) -> None:
        super().__init__()
        self.network = networks.load("efficientnet_lite0")
        self.weights = checksums(published("efficientnet_lite0", find("efficientnet_lite0")))

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Mean and deviation of every channel over the square in the middle (Huang and Belongie 2017, Eq. 13)."""
        square = F.interpolate(middle_square(images), size=(SIDE, SIDE), mode="bicubic", antialias=True).clamp(0, 1)
        moments = [torch.std_mean(features, dim=(2, 3)) for features in self.network(square, LAYERS)]
        return torch.cat([statistic for pair in moments for statistic in pair], dim=-1)
