"""Style retrieval: whether a stylized scene leads back to its style image."""

import warnings
import zlib
from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.metrics._base import stacked, with_style_images
from anystyle.types import Comparison
from anystyle.vision import networks
from anystyle.vision.statistics import centered_cosines, equalized_gray, style_statistics
from anystyle.vision.weights import checksums, find, published


class Retrieval(Metric):
    """The share of stylized scenes whose style image is the nearest of all, in colour and in equalised grey.

    Grey, so that a palette alone does not count. A row is described by the mean of its views' vectors. Rows are centred
    over all styles of their scene, style images over all of theirs, so that what a scene shows does not count. Chance
    is one over the number of style images, and figures of other numbers cannot be compared.

    A subclass says what pictures are described by, and names the two figures in :attr:`better`, colour first.
    """

    full_state_update = False
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

    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        comparison, image = with_style_images(comparison)
        for row, stylized in enumerate(comparison.stylized):
            scene = comparison.scenes[row] if comparison.scenes else ""
            self.rows.append(self._in_color_and_gray(stylized))
            self.styles.append(self._in_color_and_gray(image[row : row + 1]))
            self.scenes.append(torch.tensor([zlib.crc32(scene.encode())], device=image.device))

    def compute(self) -> dict[str, Tensor]:
        color, gray = self.better
        rows, styles, scenes = stacked(self.rows), stacked(self.styles), stacked(self.scenes)
        gallery, target = styles.unique(dim=0, return_inverse=True)  # G 2 D, N
        if len(gallery) < 2:
            warnings.warn(
                f"{color}: of {len(gallery)} style images there is nothing to choose, the figures are nan", stacklevel=2
            )
            return {name: torch.full((), float("nan"), device=rows.device) for name in (color, gray)}
        hits = [
            torch.stack([hit(rows[of, index], gallery[:, index], target[of]) for index in range(2)])
            for of in (scenes == scene for scene in scenes.unique())
        ]
        return dict(zip((color, gray), torch.cat(hits, dim=1).mean(1), strict=True))

    def _in_color_and_gray(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "1 2 D"]:
        seen = (images, equalized_gray(images))
        return torch.stack([self.describe(each).mean(0) for each in seen])[None]


class StyleRetrieval(Retrieval):
    """:class:`Retrieval` by means and deviations of EfficientNet-Lite0's features.

    A judge of what was not trained with that network; ``magenta_retrieval`` is another.
    """

    better: ClassVar[Mapping[str, str]] = {"style_retrieval": "higher", "style_retrieval_gray": "higher"}

    def __init__(self) -> None:
        super().__init__()
        self.network = networks.load("efficientnet_lite0")
        self.weights = checksums(published("efficientnet_lite0", find("efficientnet_lite0")))

    def describe(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        return style_statistics(self.network, images)


def hit(rows: Float[Tensor, "N D"], gallery: Float[Tensor, "G D"], target: Int[Tensor, " N"]) -> Float[Tensor, " N"]:
    """1 for each row that is nearest to its own style, else 0."""
    return (centered_cosines(rows, gallery).argmax(1) == target).to(rows.dtype)
