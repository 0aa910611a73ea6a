"""What style losses compare: summaries of a map of features that forget where things are.

Each is a function of features ``M C *S`` alone; two images with the same summary look alike to it.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def mean_std(features: Float[Tensor, "M C *S"]) -> tuple[Float[Tensor, "M C"], Float[Tensor, "M C"]]:
    """Mean and unbiased standard deviation of every channel over all places (Huang and Belongie 2017, equations 5, 6).

    The deviation carries the published 1e-8; its gradient is 0 where a channel is constant.
    """
    flat = features.flatten(2)
    return flat.mean(-1), flat.std(-1) + 1e-8


def pooled_moments(features: Float[Tensor, "M C *S"]) -> Float[Tensor, "M 2*C"]:
    """Mean and deviation of every channel side by side, smooth everywhere: what a linear layer reads of a map.

    Unlike :func:`mean_std` the deviation has its floor inside the root, so that a dead channel can come to life.
    """
    flat = features.flatten(2)
    return torch.cat([flat.mean(-1), (flat.var(-1, correction=0) + 1e-4).sqrt()], dim=-1)


def gram(features: Float[Tensor, "M C *S"]) -> Float[Tensor, "M C C"]:
    """Mean product of every two channels over all places (Gatys et al. 2016, equation 3, divided by the places)."""
    flat = features.flatten(2)
    return flat @ flat.mT / flat.shape[-1]


def sliced_quantiles(
    features: Float[Tensor, "M C *S"], directions: Float[Tensor, "P C"], levels: int
) -> Float[Tensor, "M P levels"]:
    """Quantiles of the features along fixed directions; their mean squared difference is a sliced Wasserstein distance.

    Args:
        features: Of any number of places.
        directions: Unit vectors in the space of channels.
        levels: How many quantiles, at the centres of as many equal shares of the places.
    """
    values = _ascending(directions @ features.flatten(2))
    # Linear interpolation between order statistics; equals sorting itself where there are `levels` places.
    return F.interpolate(values, size=levels, mode="linear", align_corners=False)


def _ascending(values: Float[Tensor, "M P S"]) -> Float[Tensor, "M P S"]:
    """Values in order along the last axis; where equal ones lie is left open."""
    if values.device.type != "cpu" or values.dtype not in (torch.float32, torch.float64):
        return values.sort(dim=-1).values
    # There numpy sorts two to four times faster than torch, and a palette loss does little else.
    plain = values.detach().numpy()
    if not values.requires_grad:
        return torch.from_numpy(np.sort(plain, axis=-1))
    return values.gather(-1, torch.from_numpy(np.argsort(plain, axis=-1)))


def unit_directions(count: int, channels: int, generator: torch.Generator) -> Float[Tensor, "count channels"]:
    """Directions drawn uniformly from the sphere."""
    return F.normalize(torch.randn(count, channels, generator=generator), dim=-1)
