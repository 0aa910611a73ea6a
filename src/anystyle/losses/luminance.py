"""Luminance: keep light and dark, at a coarse scale that leaves room for patterns."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.perception.ramps import luma
from anystyle.types import Stylization


class Luminance(Loss):
    """Keep the photographs' light and dark, whatever their mean and contrast, at a coarse scale.

    ``sum_s w_s mean (n(Y_s) - n(Y_s^photograph))^2`` with ``Y_s`` the luma averaged over s x s pixels and ``n`` the
    normalisation to mean 0 and deviation 1 of each view. Content terms on features forbid the very patterns a style
    brings when images are small; this one leaves all that is finer than ``s`` free.

    Args:
        scales: Sides of the squares that are averaged, in pixels.
        shares: Weight of each scale.
        weight: In the objective.
    """

    def __init__(
        self, *, scales: Sequence[int] = (8, 4), shares: Sequence[float] = (1.0, 0.15), weight: float = 2.0
    ) -> None:
        super().__init__()
        if len(scales) != len(shares):
            raise ValueError(f"there are {len(scales)} scales and {len(shares)} shares; give one share a scale")
        self.scales = tuple(scales)
        self.shares = tuple(shares)
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`."""
        found = luma(result.renders.color.flatten(0, 1))[:, None]
        wanted = luma(result.views.images.flatten(0, 1))[:, None]
        terms = [
            share * F.mse_loss(_normalised(F.avg_pool2d(found, scale)), _normalised(F.avg_pool2d(wanted, scale)))
            for scale, share in zip(self.scales, self.shares, strict=True)
        ]
        return torch.stack(terms).sum()


def _normalised(maps: Tensor) -> Tensor:
    centred = maps - maps.mean((-2, -1), keepdim=True)
    # The floor is the variance of an 8-bit step: flat views stay flat.
    return centred / (centred.square().mean((-2, -1), keepdim=True) + 1 / 255**2).sqrt()
