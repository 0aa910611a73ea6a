"""Optimising the pixels of an image against a network: what the network alone can ask for, with nothing in between.

A network that is to judge styles is chosen by what comes out: patterns if it sees patterns, noise or mere colour if it
can be satisfied without.
"""

from collections.abc import Callable, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.perception.features import RGB, FeatureNetwork
from anystyle.perception.statistics import gram, sliced_quantiles, unit_directions

LAYERS = (RGB, "relu1_1", "relu2_1", "relu3_1", "relu4_1")
"""What is compared: the same layers of every candidate, and the image itself for its colours."""
COARSE = 8
"""Side in pixels of the squares over which the luma of the content is kept."""


def optimise_pixels(
    content: Float[Tensor, "M 3 H W"],
    style: Float[Tensor, "M 3 h w"],
    network: FeatureNetwork,
    *,
    steps: int = 120,
    rate: float = 0.03,
    content_weight: float = 2.0,
    style_weight: float = 30.0,
    layers: Sequence[str] = LAYERS,
    told: Callable[[int], None] = lambda step: None,
) -> Float[Tensor, "M 3 H W"]:
    """Images that begin as the content and move to the style's Gram matrices, the content's coarse luma kept.

    A layer counts by its distance as a share of the distance at the start, so that no network is stronger than
    another for the size of its features.

    Args:
        content: sRGB in [0, 1].
        style: One a content.
        network: The candidate.
        steps: Of Adam.
        rate: Its learning rate.
        content_weight: Of the squared error of the normalised luma.
        style_weight: Of the mean share of distance that is left.
        layers: That are compared.
        told: Called with each step done.
    """
    with torch.no_grad():
        wanted = [gram(features) for features in network(style, layers)]
        first = [
            _distance(gram(features), target).clamp_min(1e-12)
            for features, target in zip(network(content, layers), wanted, strict=True)
        ]
        kept = coarse_luma(content)
    pixels = content.clone().requires_grad_()
    optimizer = torch.optim.Adam([pixels], lr=rate)
    for step in range(steps):
        shown = pixels.clamp(0, 1)
        left = [
            _distance(gram(features), target) / start
            for features, target, start in zip(network(shown, layers), wanted, first, strict=True)
        ]
        # What lies outside of [0, 1] has no gradient through the clamp, and is called back.
        outside = (pixels - shown.detach()).square().mean((1, 2, 3))
        kept_error = (coarse_luma(shown) - kept).square().mean((1, 2, 3))
        loss = style_weight * torch.stack(left).mean(0) + content_weight * kept_error + 10 * outside
        (gradient,) = torch.autograd.grad(loss.sum(), [pixels])
        pixels.grad = gradient
        optimizer.step()
        told(step + 1)
    return pixels.detach().clamp(0, 1)


def coarse_luma(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 1 h w"]:
    """The luma over squares of :data:`COARSE` pixels, of mean 0 and deviation 1 in each image."""
    luma = (images * images.new_tensor([0.299, 0.587, 0.114])[:, None, None]).sum(1, keepdim=True)
    small = F.avg_pool2d(luma, min(COARSE, *luma.shape[-2:]))
    centred = small - small.mean((2, 3), keepdim=True)
    return centred / (centred.square().mean((2, 3), keepdim=True) + 1 / 255**2).sqrt()


def patch_distance(first: Float[Tensor, "M 3 H W"], second: Float[Tensor, "M 3 h w"]) -> Float[Tensor, " M"]:
    """Sliced Wasserstein distance of 7 x 7 patches without their mean at two scales: texture without any network."""
    total = first.new_zeros(len(first))
    for shrink in (1, 2):
        directions = unit_directions(128, 3 * 49, torch.Generator().manual_seed(shrink)).to(first)
        sets = [sliced_quantiles(_patches(images, shrink), directions, 256) for images in (first, second)]
        total = total + (sets[0] - sets[1]).square().mean((1, 2))
    return total


def _patches(images: Float[Tensor, "M 3 H W"], shrink: int) -> Float[Tensor, "M C P"]:
    unfolded = F.unfold(F.avg_pool2d(images, shrink), 7, stride=2).unflatten(1, (3, 49))
    return (unfolded - unfolded.mean(2, keepdim=True)).flatten(1, 2)


def _distance(first: Float[Tensor, "M C C"], second: Float[Tensor, "M C C"]) -> Float[Tensor, " M"]:
    return (first - second).square().mean((1, 2))
