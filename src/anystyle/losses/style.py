"""Style: match the mean and spread of features."""

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.losses.features import StatisticsLoss
from anystyle.vision.statistics import mean_std


class StyleLoss(StatisticsLoss):
    """Match mean and deviation of VGG features of the style image (paper, equation 8; AdaIN, equation 13).

    ``sum_l mean_c (mu - mu_style)^2 + mean_c (sigma - sigma_style)^2`` over the stylized views, averaged over those
    whose style has an image; styles without an image add 0.

    Args:
        reduction: ``mean`` over channels, as published, or their ``sum``, as the equation is written.

    Example:
        >>> result = inputs.stylization(number=1)
        >>> same = replace(result, renders=replace(result.renders, color=result.views.images))
        >>> StyleLoss(network="texture")(replace(same, style=Style(result.views.images[:, 0])))
        tensor(0.)
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu1_1", "relu2_1", "relu3_1", "relu4_1"),
        size: int | None = 224,
        relative: bool = False,
        reduction: Literal["mean", "sum"] = "mean",
        weight: float = 1.0,
    ) -> None:
        super().__init__(network, layers, size, relative, weight)
        self.reduction = reduction

    def statistics(self, features: Float[Tensor, "M C h w"]) -> Float[Tensor, "M K D"]:
        """Means, then deviations."""
        return torch.stack(mean_std(features), dim=1)
