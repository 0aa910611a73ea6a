"""Statistics of features ``M C *S`` over their pixels and of colours, which style losses and metrics compare."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

EPSILON = 1e-6
CHUNK = 1024
"""Pixels whose kernels are in memory at once: few enough for a processor's cache."""


def mean_std(features: Float[Tensor, "M C *S"]) -> tuple[Float[Tensor, "M C"], Float[Tensor, "M C"]]:
    """Mean and unbiased standard deviation of every channel (Huang and Belongie 2017, equations 5 and 6).

    The deviation carries the published 1e-8; its gradient is 0 where a channel is constant.
    """
    flat = features.flatten(2)
    return flat.mean(-1), flat.std(-1) + 1e-8


def pooled_moments(features: Float[Tensor, "M C *S"]) -> Float[Tensor, "M 2*C"]:
    """Mean and deviation of every channel side by side, for a linear layer.

    Unlike in :func:`mean_std` the floor of the deviation is inside the root: a constant channel has a gradient.
    """
    flat = features.flatten(2)
    return torch.cat([flat.mean(-1), (flat.var(-1, correction=0) + 1e-4).sqrt()], dim=-1)


def equalized_gray(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
    """Images with an equalised histogram of grey: palette, exposure and contrast are gone, shapes and strokes stay."""
    luma = (images.clamp(0, 1) * images.new_tensor((0.299, 0.587, 0.114)).view(3, 1, 1)).sum(1)  # ITU-R BT.601
    levels = (luma * 255).round().long().flatten(1)  # M (H W)
    counts = torch.zeros_like(levels[:, :1]).repeat(1, 256).scatter_add(1, levels, torch.ones_like(levels))
    shares = counts.cumsum(1).to(images.dtype) / levels.shape[1]
    return shares.gather(1, levels).view(len(levels), 1, *images.shape[-2:]).expand(images.shape)


def rgb_uv_histogram(
    images: Float[Tensor, "M 3 H W"], *, bins: int = 64, width: float = 0.02, limit: int = 256
) -> Float[Tensor, "M 3 bins bins"]:
    """Intensity-weighted histograms of log-chroma, one for each colour that the two others are divided by.

    They sum to 1 over an image, with bins from -3 to 3 and an inverse-quadratic kernel of ``width`` in log-chroma.
    Images with a longer side than ``limit`` are resized to a square of this side, as published.
    """
    if max(images.shape[-2:]) > limit:
        images = F.interpolate(images, size=(limit, limit), mode="bilinear", align_corners=False)
    pixels = images.clamp(0, 1).flatten(2)  # M 3 S
    intensity = (pixels.square().sum(1) + EPSILON).sqrt()  # M S
    logs = (pixels + EPSILON).log() / width
    centres = torch.linspace(-3, 3, bins, dtype=images.dtype, device=images.device) / width
    one = images.new_ones(())

    def kernel(chroma: Tensor) -> Tensor:
        distance = chroma[..., None] - centres
        return torch.addcmul(one, distance, distance).reciprocal()  # M S bins

    def planes(red: Tensor, green: Tensor, blue: Tensor, weight: Tensor) -> Tensor:
        rg, rb, gb = (kernel(chroma) for chroma in (red - green, red - blue, green - blue))
        gr, br, bg = (each.flip(-1) for each in (rg, rb, gb))  # the centres are symmetric
        return torch.stack([(weight[..., None] * u).mT @ v for u, v in ((rg, rb), (gr, gb), (br, bg))], dim=1)

    parts = zip(logs.split(CHUNK, dim=-1), intensity.split(CHUNK, dim=-1), strict=True)
    histogram = torch.stack([planes(log[:, 0], log[:, 1], log[:, 2], weight) for log, weight in parts]).sum(0)
    return histogram / (histogram.sum((1, 2, 3), keepdim=True) + EPSILON)


def hellinger(first: Float[Tensor, "M 3 b b"], second: Float[Tensor, "M 3 b b"]) -> Float[Tensor, " M"]:
    """Hellinger distance of histograms that sum to 1, in [0, 1]."""
    # The square root has no finite gradient at 0, where a bin is empty.
    tiny = torch.finfo(first.dtype).tiny
    difference = first.clamp_min(tiny).sqrt() - second.clamp_min(tiny).sqrt()
    return difference.flatten(1).norm(dim=-1) / 2**0.5
