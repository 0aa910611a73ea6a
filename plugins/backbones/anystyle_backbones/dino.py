"""DINOv2's tokens ahead of its blocks, in its variants without registers."""

from collections.abc import Callable
from math import isqrt

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.tokens import grid_of, normalised
from anystyle.types import Tokens
from anystyle_backbones.heads import positions

OFFSET = 0.1
"""Added to the sides of a grid of patches where position embeddings are resampled, as DINOv2 was trained."""


def patch_tokens(
    images: Float[Tensor, "B V 3 H W"],
    proj: nn.Conv2d,
    cls_token: Float[Tensor, "1 1 C"],
    pos_embed: Float[Tensor, "1 L C"],
) -> Tokens:
    """Class token and patches of sRGB images in [0, 1], with positions added."""
    batch, views = images.shape[:2]
    grid = grid_of(images, proj.kernel_size[0])
    patches = proj(normalised(images.to(proj.weight.dtype)).flatten(0, 1)).flatten(2).mT
    cls = cls_token.to(patches.dtype).expand(batch * views, -1, -1)
    tokens = torch.cat([cls, patches], dim=1) + grid_embedding(pos_embed, grid).to(patches.dtype)
    return Tokens(tokens.unflatten(0, (batch, views)), grid=grid, special=1)


def grid_embedding(stored: Float[Tensor, "1 L C"], grid: tuple[int, int]) -> Float[Tensor, "1 M C"]:
    """Position embeddings of the class token and of a grid."""
    side = isqrt(stored.shape[1] - 1)
    return positions(stored, grid, scale_factor=[(length + OFFSET) / side for length in grid])


def by_view(function: Callable[[Tensor], Tensor], data: Float[Tensor, "B V P C"]) -> Float[Tensor, "B V P C"]:
    """Apply a function to the tokens of each view."""
    return function(data.flatten(0, 1)).unflatten(0, (-1, data.shape[1]))
