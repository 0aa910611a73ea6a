"""Content: keep the features of the photographs."""

from collections.abc import Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.losses.features import FeatureFn, FeatureLoss
from anystyle.types import Stylization


class Content(FeatureLoss):
    """Keep the VGG features of the photographs (paper, equation 7).

    ``sum_l mean (phi_l(render) - phi_l(photograph))^2``, or the sum of each view in place of its mean.

    Args:
        size: Side that renders and photographs are resized to; ``None`` keeps them as they are.
        reduction: ``mean`` over the features of a view, as published, or their ``sum``, as the equation is written.
        weight: In the objective; published as 0.05 for the head variant, 0.075 for the aggregator variant.

    Example:
        >>> result = inputs.stylization()
        >>> same = replace(result, renders=replace(result.renders, color=result.views.images))
        >>> Content(network="texture", layers=["rgb"])(same)
        tensor(0.)
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu3_1", "relu4_1"),
        size: int | None = 224,
        reduction: Literal["mean", "sum"] = "mean",
        weight: float = 0.05,
    ) -> None:
        super().__init__(network, layers, size, weight)
        self.reduction: Literal["mean", "sum"] = reduction

    def compare(self, result: Stylization, images: Float[Tensor, "M 3 H W"], features: FeatureFn) -> Float[Tensor, ""]:
        layers = zip(features(), self.targets(result.views.images), strict=True)
        scale = 1 if self.reduction == "mean" else 1 / len(images)
        return torch.stack([scale * F.mse_loss(*pair, reduction=self.reduction) for pair in layers]).sum()
