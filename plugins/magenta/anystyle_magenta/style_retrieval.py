"""Style retrieval: whether the style image nearest to a stylized scene is its own."""

import warnings
import zlib
from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Metric, accepts_tensors
from anystyle.metrics.base import stacked, with_style_images
from anystyle.types import Comparison
from anystyle.vision import networks
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.preprocess import middle_square
from anystyle.vision.statistics import centered_cosines, equalized_gray
from anystyle.vision.weights import checksums, find, published

LAYERS = ("expand3", "expand5", "expand8")
"""Of the sets of EfficientNet-Lite0 tried these find the other half of the same painting most often: among 61 paintings
in 82 % of cases, and in 70 % in equalised grey; the first four blocks in 70 % and 57 %."""
SIDE = 224
"""Sides in pixels of the square that is looked at, as in the network's training."""


class Retrieval(Metric):
    """The share of stylized scenes whose style image is the nearest of all, in colour and in equalised grey.

    Measured in gray as well, so that matching the palette alone does not score. A row is described by the mean of its
    views' vectors. Rows are centred over all styles of their scene, style images over all of theirs, so that what a
    scene shows does not count. Chance is one over the number of style images, and scores of other numbers cannot be
    compared.

    A subclass defines the vectors, and names the two scores in :attr:`better`, colour first.
    """

    full_state_update = False
    takes = ("preds", "style", "scenes")
    rows: list[Tensor]
    styles: list[Tensor]
    scenes: list[Tensor]

    def __init__(self) -> None:
        super().__init__()
        for state in ("rows", "styles", "scenes"):
            self.add_state(state, [], dist_reduce_fx="cat")

    @abstractmethod
    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Vectors of sRGB images in [0, 1]."""

    @accepts_tensors
    def update(self, comparison: Comparison) -> None:
        comparison, image = with_style_images(comparison)
        for row, stylized in enumerate(comparison.stylized):
            scene = comparison.scenes[row] if comparison.scenes else ""
            self.rows.append(self._in_color_and_gray(stylized))
            self.styles.append(self._in_color_and_gray(image[row : row + 1]))
            self.scenes.append(torch.tensor([zlib.crc32(scene.encode())], device=image.device))

    def compute(self) -> dict[str, Tensor]:
        hits = self.of_each_row()
        if all(values.isnan().all() for values in hits.values()):
            text = "there is no scene in two styles, or nothing to choose among; the scores are nan"
            warnings.warn(f"{next(iter(hits))}: {text}", stacklevel=2)
        return {name: values.nanmean() for name, values in hits.items()}

    def of_each_row(self) -> dict[str, Float[Tensor, " N"]]:
        """1 for each row that is nearest to its own style, else 0; ``nan`` for the only row of a scene."""
        rows, styles, scenes = stacked(self.rows), stacked(self.styles), stacked(self.scenes)
        gallery, target = torch.cat([styles, *self._gallery]).unique(dim=0, return_inverse=True)  # G 2 D, N + ...
        hits = rows.new_full((2, len(rows)), torch.nan)
        for scene in scenes.unique():
            of_scene = scenes == scene
            if of_scene.sum() > 1 and len(gallery) > 1:
                cosines = [centered_cosines(rows[of_scene, index], gallery[:, index]) for index in range(2)]
                hits[:, of_scene] = (torch.stack(cosines).argmax(2) == target[: len(rows)][of_scene]).to(hits)
        return dict(zip(self.better, hits, strict=True))

    @cached_property
    def _gallery(self) -> list[Float[Tensor, "1 2 D"]]:
        return [self._in_color_and_gray(image[None].to(self.device)) for image in self.gallery]

    def _in_color_and_gray(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "1 2 D"]:
        def look(batch: Tensor) -> list[Tensor]:
            return [torch.stack([self.describe(seen) for seen in (batch, equalized_gray(batch))], dim=1)]

        return CACHE.features(images, ("retrieval", *self.better, *self.weights.values()), look)[0].mean(
            0, keepdim=True
        )


class StyleRetrieval(Retrieval):
    """:class:`Retrieval` by means and deviations of EfficientNet-Lite0's features.

    A judge of what was not trained with that network; ``magenta_retrieval`` is another.

    Example:
        >>> images = torch.rand(2, 3, 64, 64, generator=torch.Generator().manual_seed(0))
        >>> metric = StyleRetrieval()
        >>> metric.update(images, images)
        >>> metric.compute()  # results are their style images
        {'style_retrieval': tensor(1.), 'style_retrieval_gray': tensor(1.)}
    """

    better: ClassVar[Mapping[str, str]] = {"style_retrieval": "higher", "style_retrieval_gray": "higher"}

    def __init__(self) -> None:
        super().__init__()
        self.network = networks.load("efficientnet_lite0")
        self.weights = checksums(published("efficientnet_lite0", find("efficientnet_lite0")))

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Mean and deviation of every channel over the square in the middle (Huang and Belongie 2017, Eq. 13)."""
        square = middle_square(images)
        square = F.interpolate(square, size=(SIDE, SIDE), mode="bicubic", antialias=True).clamp(0, 1)
        moments = [torch.std_mean(features, dim=(2, 3)) for features in self.network(square, LAYERS)]
        return torch.cat([statistic for pair in moments for statistic in pair], dim=-1)
