"""Luminance: keep light and dark, at a coarse scale that leaves room for patterns."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.color import rgb_to_grayscale
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.types import Stylization


class Luminance(Loss):
    """Keep the photographs' light and dark, whatever their mean and contrast, at a coarse scale.

    ``sum_s w_s mean (n(Y_s) - n(Y_s^photograph))^2`` with ``Y_s`` the luma averaged over s x s pixels and ``n`` the
    normalisation to mean 0 and deviation 1 of each view. Content terms on features forbid the very patterns a style
    brings when images are small; this one leaves all that is finer than ``s`` free.

    Args:
        scales: Sides of the squares that are averaged, in pixels.
        scale_weights: Weight of each scale.
        weight: In the objective.
    """

    def __init__(
        self, *, scales: Sequence[int] = (8, 4), scale_weights: Sequence[float] = (1.0, 0.15), weight: float = 2.0
    ) -> None:
        super().__init__()
        if len(scales) != len(scale_weights):
            raise UserError(f"there are {len(scales)} scales and {len(scale_weights)} weights; give one weight a scale")
        self.scales = tuple(scales)
        self.scale_weights = tuple(scale_weights)
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        render, photograph = result.renders.color.flatten(0, 1), result.views.images.flatten(0, 1)
        terms = [
            scale_weight * F.mse_loss(coarse_luma(render, scale), coarse_luma(photograph, scale))
            for scale, scale_weight in zip(self.scales, self.scale_weights, strict=True)
        ]
        return torch.stack(terms).sum()


def coarse_luma(images: Float[Tensor, "M 3 H W"], scale: int) -> Float[Tensor, "M 1 h w"]:
    """The luma averaged over squares of ``scale`` pixels, of mean 0 and deviation 1 in each image."""
    small = F.avg_pool2d(rgb_to_grayscale(images), scale)
    centred = small - small.mean((-2, -1), keepdim=True)
    # The floor is the variance of an 8-bit step: flat views stay flat.
    return centred / (centred.square().mean((-2, -1), keepdim=True) + 1 / 255**2).sqrt()
