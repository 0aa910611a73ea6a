"""Ramps: the colours of a picture from dark to light."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from kornia.color import rgb_to_grayscale
from torch import Tensor


def ramp(images: Float[Tensor, "B 3 h w"], knots: int) -> Float[Tensor, "B knots 3"]:
    """The colours of each image from the dark to the light end of their first principal axis.

    Args:
        images: sRGB.
        knots: Into so many parts of equal size the ordered pixels are split; each is averaged.
    """
    colors = images.flatten(2).mT
    centred = colors - colors.mean(1, keepdim=True)
    axis = torch.linalg.eigh(centred.mT @ centred).eigenvectors[..., -1:]  # B 3 1
    lighter = torch.where(rgb_to_grayscale(axis[..., None])[..., 0] < 0, -1.0, 1.0)
    order = (centred @ (axis * lighter)).argsort(dim=1)
    return F.adaptive_avg_pool1d(colors.gather(1, order.expand_as(colors)).mT, knots).mT
