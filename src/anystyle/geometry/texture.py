"""Textures laid over what a camera sees."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def sample_texture(texture: Float[Tensor, "B C r c"], places: Float[Tensor, "B V p 2"]) -> Float[Tensor, "B V p C"]:
    """A texture at some places, linear between its samples; beyond its borders it goes on mirrored.

    Args:
        texture: Over x and y in [-1, 1], border to border.
        places: x and y.
    """
    sampled = F.grid_sample(texture, places, mode="bilinear", padding_mode="reflection", align_corners=False)
    return sampled.movedim(1, -1)
