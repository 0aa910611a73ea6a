"""Sliced Wasserstein: match the whole distribution of colours, or of features."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.losses.features import StatisticsLoss
from anystyle.vision.statistics import sliced_quantiles, unit_directions


class SlicedWasserstein(StatisticsLoss):
    """Match the distribution of colours or features of the style image (Heitz et al. 2021, equation 4).

    ``sum_l`` of the mean squared difference of the quantiles along random directions, averaged over views whose style
    has an image. On ``rgb`` alone it is a palette loss: unlike a mean it keeps distinct colours distinct.

    Args:
        directions: Number of random directions, drawn once from ``seed``.
        levels: Number of quantiles.
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
        self.directions, self.levels, self.seed = directions, levels, seed

    def statistics(self, features: Float[Tensor, "M C h w"]) -> Float[Tensor, "M K D"]:
        # Drawn on the CPU: equal for render and style, and on every machine.
        generator = torch.Generator().manual_seed(self.seed)
        directions = unit_directions(self.directions, features.shape[1], generator).to(features)
        return sliced_quantiles(features, directions, self.levels).flatten(1)[:, None]
