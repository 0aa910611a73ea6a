"""Ramps: the colours of a picture from dark to light, and pictures painted off one."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

LUMA = (0.299, 0.587, 0.114)
"""Weights of sRGB values as they are, Rec. 601."""


def ramp(images: Float[Tensor, "B 3 h w"], knots: int) -> Float[Tensor, "B knots 3"]:
    """The colours of each image from the dark to the light end of their first principal axis, in equal shares."""
    colors = images.flatten(2).mT
    centred = colors - colors.mean(1, keepdim=True)
    axis = torch.linalg.eigh(centred.mT @ centred).eigenvectors[..., -1:]  # B 3 1
    lighter = torch.where((axis.mT @ axis.new_tensor(LUMA)) < 0, -1.0, 1.0)[..., None]
    order = (centred @ (axis * lighter)).argsort(dim=1)
    return F.adaptive_avg_pool1d(colors.gather(1, order.expand_as(colors)).mT, knots).mT


def shares(values: Float[Tensor, "B *places"]) -> Float[Tensor, "B *places"]:
    """Which share of its row's values is below each, in [0, 1); equal ones in the order they lie in."""
    flat = values.flatten(1)
    order = flat.argsort(dim=1, stable=True)
    rising = torch.arange(flat.shape[1], device=flat.device, dtype=flat.dtype) / flat.shape[1]
    return torch.empty_like(flat).scatter_(1, order, rising.expand_as(flat)).view_as(values)


def luma(images: Float[Tensor, "*batch 3 H W"]) -> Float[Tensor, "*batch H W"]:
    """How light each pixel is, in [0, 1]."""
    return (images * images.new_tensor(LUMA)[:, None, None]).sum(-3)


def painted(place: Float[Tensor, "B V H W"], colors: Float[Tensor, "B knots 3"]) -> Float[Tensor, "B V 3 H W"]:
    """Each pixel in the colour at its place on the ramp, in [0, 1], linear between knots."""
    along = place.flatten(1) * (colors.shape[1] - 1)
    low = along.floor().long().clamp_max(colors.shape[1] - 2)[..., None].expand(-1, -1, 3)
    mixed = torch.lerp(colors.gather(1, low), colors.gather(1, low + 1), (along - low[..., 0])[..., None])
    return mixed.unflatten(1, place.shape[1:]).movedim(-1, 2)
