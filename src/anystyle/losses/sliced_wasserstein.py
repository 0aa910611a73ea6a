"""Sliced Wasserstein: match the whole distribution of colours, or of features."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.losses._features import StatisticsLoss
from anystyle.perception.statistics import sliced_quantiles, unit_directions


class SlicedWasserstein(StatisticsLoss):
    """Match the distribution of colours or features of the style image (Heitz et al. 2021, equation 4).

    ``sum_l`` of the mean squared difference of the quantiles along random directions, averaged over views whose style
    has an image. On ``rgb`` alone it is a palette loss: unlike a mean it keeps two colours two.

    Args:
        directions: Along how many the distributions are compared; drawn once, from ``seed``.
        levels: How many quantiles are compared.
        seed: Of the directions.
    """

    def __init__(
        self,
        *,
        network: str = "texture",
        layers: Sequence[str] = ("rgb",),
        size: int | None = None,
        directions: int = 32,
        levels: int = 256,
        relative: bool = False,
        seed: int = 0,
        weight: float = 1.0,
    ) -> None:
        super().__init__(network, layers, size, relative, weight)
        self.directions = directions
        self.levels = levels
        self.seed = seed

    def statistics(self, features: Float[Tensor, "M C h w"]) -> Float[Tensor, "M K D"]:
        # The same for render and style, and on every machine: drawn on the CPU, from the seed alone.
        generator = torch.Generator().manual_seed(self.seed)
        directions = unit_directions(self.directions, features.shape[1], generator).to(features)
        return sliced_quantiles(features, directions, self.levels).flatten(1)[:, None]
