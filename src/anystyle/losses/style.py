"""Style: match the mean and spread of features."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.losses._features import StatisticsLoss
from anystyle.perception.eager_backward import eager_backward
from anystyle.perception.statistics import mean_std
from anystyle.types import Stylization


class StyleLoss(StatisticsLoss):
    """Match mean and deviation of VGG features of the style image (paper, equation 8; AdaIN, equation 13).

    ``sum_l mean_c (mu - mu_style)^2 + mean_c (sigma - sigma_style)^2`` over the stylized views, averaged over those
    whose style has an image; a text alone adds nothing.

    Args:
        reduction: ``mean`` over channels, as published, or their ``sum``, as the equation is written.
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

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """The bundled network, on small pictures."""
        return {"network": "texture", "size": 48}

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`."""
        return eager_backward(partial(self.distance, result), result.renders.color.flatten(0, 1))

    def statistics(self, features: Float[Tensor, "M C h w"]) -> Float[Tensor, "M K D"]:
        """Means, then deviations."""
        return torch.stack(mean_std(features), dim=1)
