"""Gram: match the correlations of features."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from anystyle.losses.features import StatisticsLoss


def gram(features: Float[Tensor, "M C *S"]) -> Float[Tensor, "M C C"]:
    """Mean product of every two channels over all pixels (Gatys et al. 2016, equation 3, divided by their number)."""
    flat = features.flatten(2)
    return flat @ flat.mT / flat.shape[-1]


class Gram(StatisticsLoss):
    """Match the Gram matrices of features of the style image (Gatys et al. 2016, equations 3 to 5).

    ``sum_l mean_ij (G_ij - G_ij^style)^2`` with ``G = F F^T / (h w)``, averaged over views whose style has an image.

    Example:
        >>> import torch
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> from anystyle.types import Style
        >>> result = stylization()
        >>> renders = replace(result.renders, color=torch.full_like(result.renders.color, 0.5))
        >>> gray = Style(image=torch.full((1, 3, 48, 40), 0.25))
        >>> Gram(network="texture", layers=("rgb",))(replace(result, renders=renders, style=gray))
        tensor(0.0352)
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu1_1", "relu2_1", "relu3_1", "relu4_1", "relu5_1"),
        size: int | None = 224,
        relative: bool = False,
        weight: float = 1.0,
    ) -> None:
        super().__init__(network, layers, size, relative, weight)

    def statistics(self, features: Float[Tensor, "M C h w"]) -> Float[Tensor, "M K D"]:
        return gram(features).flatten(1)[:, None]
