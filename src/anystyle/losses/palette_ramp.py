"""Palette ramp: the n-th darkest pixel of a scene takes the n-th colour of the style."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.perception.compare import LUMA, mean_where, style_images
from anystyle.types import Stylization


class PaletteRamp(Loss):
    """Put the style's colours onto the photographs' light and dark, in equal shares: a gradient map as a target.

    The style's pixels, ordered along their first principal axis from dark to light, are averaged within ``knots``
    equal shares: its ramp. A pixel of a photograph whose luma is above that of a share r of the scene is to have the
    colour at r of the ramp, and the term is the mean squared distance to it, over views whose style has an image.
    Like colour transfer by luminance (Welsh et al. 2002, section 2) it keeps what is light light; by ranks, like the
    exact one-dimensional transport of Pitie et al. 2007 (section 2), it also gives every colour its share. A distance
    between distributions leaves open which pixel takes which colour and is learnt far more slowly; this one settles it.

    Args:
        knots: Of the ramp.
        weight: In the objective.

    Raises:
        ValueError: ``knots`` is below 2.
    """

    def __init__(self, *, knots: int = 32, weight: float = 10.0) -> None:
        super().__init__()
        if knots < 2:
            raise ValueError(f"loss.palette_ramp.knots is {knots}; give at least 2")
        self.knots = knots
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`."""
        styles = style_images(result)
        if styles is None:
            return result.renders.color.new_zeros(())
        image, given = styles
        with torch.no_grad():
            target = painted(ranks(result.views.images), ramp(image, self.knots))
        return mean_where((result.renders.color - target).square().mean((1, 2, 3, 4)), given)


def ramp(images: Float[Tensor, "B 3 h w"], knots: int) -> Float[Tensor, "B knots 3"]:
    """The colours of each image from the dark to the light end of their first principal axis, in equal shares."""
    colors = images.flatten(2).mT
    centred = colors - colors.mean(1, keepdim=True)
    axis = torch.linalg.eigh(centred.mT @ centred).eigenvectors[..., -1:]  # B 3 1
    lighter = torch.where((axis.mT @ axis.new_tensor(LUMA)) < 0, -1.0, 1.0)[..., None]
    order = (centred @ (axis * lighter)).argsort(dim=1)
    return F.adaptive_avg_pool1d(colors.gather(1, order.expand_as(colors)).mT, knots).mT


def ranks(images: Float[Tensor, "B V 3 H W"]) -> Float[Tensor, "B V H W"]:
    """Which share of its scene's pixels is darker than each, in [0, 1)."""
    luma = (images * images.new_tensor(LUMA)[:, None, None]).sum(2)
    flat = luma.flatten(1)
    places = torch.arange(flat.shape[1], device=flat.device).expand_as(flat)
    order = flat.argsort(dim=1, stable=True)
    return torch.empty_like(flat).scatter_(1, order, places.to(flat.dtype) / flat.shape[1]).view_as(luma)


def painted(rank: Float[Tensor, "B V H W"], colors: Float[Tensor, "B knots 3"]) -> Float[Tensor, "B V 3 H W"]:
    """Each pixel in the colour at its place on the ramp, linear between knots."""
    place = rank.flatten(1) * (colors.shape[1] - 1)
    low = place.floor().long().clamp_max(colors.shape[1] - 2)[..., None].expand(-1, -1, 3)
    mixed = torch.lerp(colors.gather(1, low), colors.gather(1, low + 1), (place - low[..., 0])[..., None])
    return mixed.unflatten(1, rank.shape[1:]).movedim(-1, 2)
