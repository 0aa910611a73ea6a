"""Simultaneously optimised scales: Gram matrices, means and deviations at many sizes at once."""

from collections.abc import Sequence

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.losses.features import FeatureFn, FeatureLoss, features_to_compare, mean_where, style_images
from anystyle.ranges import AtLeastOne
from anystyle.types import Stylization
from anystyle.vision.feature_cache import identity
from anystyle.vision.statistics import mean_std
from anystyle_methods.gram import gram


class SimultaneousScales(FeatureLoss):
    """Match Gram matrices, means and deviations of features at every scale of an image pyramid (SOS of SGSST).

    ``sum_s sum_l g / C_l^2 mean_ij (G_ij - G_ij^style)^2 + m (mean_c (mu - mu^style)^2 + mean_c (sigma -
    sigma^style)^2)``: Galerne et al. 2025; scale ``s`` halves render and style image ``s`` times. Features of a layer
    are divided by their mean over the style image at that scale, because the published weights belong to a network
    with activations of mean 1.

    Args:
        scales: Number of sizes; fewer where the smallest would be under 16 pixels.
        gram_weight: ``g``; 1000 in SGSST, as in Gatys et al. 2017.
        moments_weight: ``m``; 10,000 in SGSST.

    Example:
        >>> import torch
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> from anystyle.types import Style
        >>> result = stylization()
        >>> renders = replace(result.renders, color=torch.full_like(result.renders.color, 0.5))
        >>> gray = Style(image=torch.full((1, 3, 48, 40), 0.25))
        >>> loss = SimultaneousScales(network="texture", layers=("rgb",), scales=2, gram_weight=1, moments_weight=1)
        >>> loss(replace(result, renders=renders, style=gray))
        tensor(4.)
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu1_1", "relu2_1", "relu3_1", "relu4_1", "relu5_1"),
        scales: AtLeastOne = 3,
        gram_weight: float = 1e3,
        moments_weight: float = 1e4,
        size: int | None = None,
        weight: float = 1.0,
    ) -> None:
        super().__init__(network, layers, size, weight)
        self.scales, self.gram_weight, self.moments_weight = scales, gram_weight, moments_weight

    def compare(self, result: Stylization, images: Float[Tensor, "M 3 H W"], features: FeatureFn) -> Float[Tensor, ""]:
        styles = style_images(result)
        if styles is None:
            return images.new_zeros(())
        style, given = styles
        num_views = len(images) // len(style)
        total = images.new_zeros(len(images))
        for scale in range(self.scales):
            if min(*images.shape[-2:], *style.shape[-2:]) < 16 * 2**scale:
                break
            seen = self.features(F.avg_pool2d(images, 2**scale)) if scale else features()
            total = total + self._at_one_scale(seen, style, scale, num_views)
        return mean_where(total, given.repeat_interleave(num_views))

    def _at_one_scale(
        self, seen: Sequence[Tensor], style: Float[Tensor, "B 3 h w"], scale: int, num_views: int
    ) -> Float[Tensor, " M"]:
        def small(images: Tensor) -> list[Tensor]:
            return self.features(F.avg_pool2d(images, 2**scale))

        targets = features_to_compare(style, (identity(self.network), *self.layers, self.size, scale), small)
        total = seen[0].new_zeros(len(seen[0]))
        for features, target in zip(seen, targets, strict=True):
            unit = target.mean((1, 2, 3), keepdim=True).clamp_min(1e-6)
            features, target = features / unit.repeat_interleave(num_views, 0), target / unit
            pairs = zip((gram(features), *mean_std(features)), (gram(target), *mean_std(target)), strict=True)
            terms = [(a - b.repeat_interleave(num_views, 0)).square().flatten(1).mean(1) for a, b in pairs]
            total = total + self.gram_weight / features.shape[1] ** 2 * terms[0]
            total = total + self.moments_weight * (terms[1] + terms[2])
        return total
