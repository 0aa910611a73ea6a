"""Losses of the tiny experiments."""

from collections.abc import Sequence
from typing import Annotated

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.color import rgb_to_grayscale
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.ranges import NonNegative, Range
from anystyle.types import Stylization


class Checkerboard(Loss):
    """Keep the change that a style makes free of a pattern that repeats with the patches.

    ``mean |m - mean m|`` with ``m``, of ``period x period`` pixels, the change from photograph to render averaged over
    all patches of a view. Transposed convolutions draw such patterns at no cost (Odena et al., Deconvolution and
    Checkerboard Artifacts, Distill 2016), and losses on statistics of features take them for strokes: strokes that
    follow the scene average out over patches, a lattice does not.

    Args:
        period: Side of a patch, in pixels; of the bundled backbones by default.
        weight: In the objective; values are near 0.01.

    Example:
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()
        >>> renders = replace(result.renders, color=result.views.images + torch.tensor([0.0, 0.1]).repeat(40))
        >>> Checkerboard()(replace(result, renders=renders))  # the mean amplitude of stripes
        tensor(0.0500)
    """

    def __init__(self, *, period: Annotated[int, Range(ge=2)] = 14, weight: float = 40.0) -> None:
        super().__init__()
        self.period = period
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        # A last, partial patch is left out.
        change = (result.renders.color - result.views.images).flatten(0, 1)
        rows, columns = (side // self.period for side in change.shape[-2:])
        whole = change[..., : rows * self.period, : columns * self.period]
        repeated = whole.unflatten(-2, (rows, -1)).unflatten(-1, (columns, -1)).mean((-4, -2))
        return (repeated - repeated.mean((-2, -1), keepdim=True)).abs().mean()


class EdgeAwareSmoothness(Loss):
    """Prefer renders that change where the photographs do: ``mean |dx I| exp(-k |dx I^photograph|)``, across plus down.

    The first-order smoothness of Godard et al. 2017 (Eq. 2 there, on disparities), on colours: absolute differences of
    neighbouring pixels, averaged over channels. Terms on the distribution of colours allow stripes unrelated to
    the scene; this one penalises them, but not the edges of the scene.

    Args:
        sharpness: The ``k`` above, for differences of sRGB in [0, 1].
        weight: In the objective.

    Example:
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()
        >>> ramp = torch.linspace(0, 0.79, 80).expand_as(result.views.images)  # steps of 0.01 across
        >>> EdgeAwareSmoothness(sharpness=0.0)(replace(result, renders=replace(result.renders, color=ramp)))
        tensor(0.0100)
    """

    def __init__(self, *, sharpness: NonNegative = 20.0, weight: float = 1.0) -> None:
        super().__init__()
        self.sharpness, self.weight = sharpness, weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        color, photograph = result.renders.color, result.views.images
        terms = []
        for axis in (-1, -2):
            edges = photograph.diff(dim=axis).abs().mean(2, keepdim=True)
            terms.append((color.diff(dim=axis).abs() * (-self.sharpness * edges).exp()).mean())
        return terms[0] + terms[1]


class Luminance(Loss):
    """Keep the photographs' light and dark, whatever their mean and contrast, at a coarse scale.

    ``sum_s w_s mean (n(Y_s) - n(Y_s^photograph))^2`` with ``Y_s`` the luma averaged over s x s pixels and ``n`` the
    normalisation to mean 0 and deviation 1 of each view. Content terms on features forbid the very patterns a style
    brings when images are small; this one leaves all that is finer than ``s`` free.

    Args:
        scales: Sides of the squares that are averaged, in pixels.
        scale_weights: Weight of each scale.
        weight: In the objective.

    Example:
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()
        >>> negative = replace(result, renders=replace(result.renders, color=1 - result.views.images))
        >>> round(float(Luminance()(negative)), 1)  # 4 for each weight of a scale
        4.6
    """

    def __init__(
        self, *, scales: Sequence[int] = (8, 4), scale_weights: Sequence[float] = (1.0, 0.15), weight: float = 2.0
    ) -> None:
        super().__init__()
        if len(scales) != len(scale_weights):
            raise UserError(
                f"there are {len(scales)} scales and {len(scale_weights)} weights; give one weight per scale"
            )
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
