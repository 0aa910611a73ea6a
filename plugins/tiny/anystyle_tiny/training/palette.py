"""Palettes: a few colours that stand for all pixels of a picture."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

COLORS = 4
"""Colours of a palette."""


def palette_loss(
    palette: Float[Tensor, "M colors 3"], images: Float[Tensor, "M 3 H W"], *, directions: int = 16
) -> Float[Tensor, " M"]:
    """How far the pixels are from a palette of colours of equal weight: a sliced Wasserstein distance, squared.

    Along a direction the sorted pixels are split into as many equal groups as there are colours, and each group is
    carried to the colour of its rank; the part that no palette could avoid, the spread within groups, is left out.
    """
    count = palette.shape[1]
    axes = F.normalize(torch.randn(directions, 3, device=images.device, dtype=palette.dtype), dim=-1)
    # Three pixels in four are left out: colours of a picture repeat.
    pixels = images[..., ::2, ::2].flatten(2).to(palette.dtype)
    pixels = pixels[..., : pixels.shape[-1] // count * count]
    sorted_pixels = (axes @ pixels).sort(dim=-1).values  # M directions S
    groups = sorted_pixels.unflatten(-1, (count, -1)).mean(-1)
    ranked = (axes @ palette.mT).sort(dim=-1).values
    return (ranked - groups).square().mean((-2, -1))
